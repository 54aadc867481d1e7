"""All tuned constants of the verifier of shapes, in one table, by mechanism.

Each mechanism states its benefit: the change when it is switched off, in correlation (CC) of maps unless another figure
is named, on the same seeds under noise N2 (``eitskin evaluate --phantoms paper_mm --solver verified`` and ``eitskin
bench verify``). Differences of 0.002, and one map of 40, are noise. Costs and gains are in chi-squared. Contrasts,
sizes and scales are compared by their logarithms.
"""

from typing import Final

# Time. A frame that has used most of its budget confirms what it has: nothing new is tried.

SEARCH_SHARE_OF_BUDGET: Final = 0.85

# Prior of touches: with the skin's own contrasts and sizes it decides where data tell only size times contrast.
# The cost of touches that the start has not shown keeps the sheet's errors from being explained by more touches.

DISTINCT_PLACES: Final = 60
"""Areas of a sheet that can be told apart, roughly."""

EXPECTED_TOUCHES: Final = 3.0

COST_OF_TOUCH_NOT_SHOWN: Final = 8.0
"""In addition to the cost of every touch, because the network's map is evidence too."""

CONTRAST_LOG_SD_BEYOND_SKIN: Final = 0.3
"""About the range that a skin states: no range is a wall."""

SIZE_LOG_SD_BEYOND_SKIN: Final = 0.1

OWN_CONTRAST_SD: Final = 0.3
"""Of each touch's log contrast about the mean of its frame's touches of the same sign."""

ASPECT_LOG_SD: Final = 0.35
"""Of length over width: most touches are about as long as wide."""

BORDER_MM: Final = 3.0
"""Usual width of a press' graded border."""

BORDER_SD_MM: Final = 2.0

# Bounds of what may be fitted.

MIN_FROM_EDGE_MM: Final = 0.5
"""From the sheet's edge to a centre."""

MIN_HALF_SIDE_MM: Final = 1.5

MAX_HALF_SIDE_MM: Final = 45.0

CONTRAST_BOUNDS: Final = (0.1, 200.0)

MIN_ABS_LOG_CONTRAST: Final = 0.05
"""A touch that changes nothing is none."""

MAX_BORDER_MM: Final = 8.0

# Steps of a fit. Keeping derivatives for one step saves 0.15 s of a lab-like press' 0.24 s.

MAX_STEPS: Final = 10

MAX_STEP: Final = (6.0, 6.0, 3.0, 3.0, 0.3, 0.7, 1.5)
"""Of each parameter, in mm, mm, mm, mm, rad, log contrast and mm."""

FIRST_DAMPING: Final = 1e-2

MIN_DAMPING: Final = 1e-4
"""Worth 0.001 on paper_mm."""

DAMPING_UP: Final = 8.0

DAMPING_DOWN: Final = 5.0

MAX_STEP_TRIES: Final = 4
"""Each shorter than the one before."""

MIN_GAIN_OF_STEP: Final = 1.0
"""A step that gains less is the last."""

MIN_GAIN_SHARE_OF_EXCESS: Final = 0.02
"""A step that gains less of what chi-squared has more than rows is the last, too: something else is wrong. Pairs seen
at rest 0.011."""

MIN_PROMISED_GAIN_PER_PARAMETER: Final = 0.02
"""A step that should gain less is not tried: it would go a seventh of a standard error."""

MAX_GAIN_OVER_PROMISED: Final = 2.0
"""Times that a step may gain what derivatives promise; a fit that has to cost less than another ends where that is not
enough. Touches of contrast 2 take a seventh less, lab-like presses a twelfth, and two of 320 maps changed."""

MAX_ERROR_OF_KEPT_DERIVATIVES: Final = 0.3
"""Share of a residual's change that derivatives may have promised otherwise, if they are kept for another step."""

EXPLAINED_P_OVER_LEVEL: Final = 5.0
"""The search goes on until p is as many times above the level of flags."""

# Starts from the network's map. Two rectangles for an L: 0.045 for L-shaped bars; turned ones: lab-like presses 0.015.

MIN_START_SIDE_MM: Final = 3.0

MIN_SHARE_TO_CUT: Final = 0.3
"""Rows and columns of pixels without a larger share are not cut between."""

MIN_MISFIT_TO_CUT_PX: Final = 2.5
"""Residual of a map after one rectangle, in squares of whole pixels, above which two are tried."""

MAX_MISFIT_RATIO_OF_TWO: Final = 0.45
"""Of what two rectangles leave to what one leaves."""

MIN_MISFIT_TO_TURN_PX: Final = 1.5

MAX_MISFIT_RATIO_OF_TURNED: Final = 0.8

MAX_MISFIT_RATIO_TURNED_TO_TWO: Final = 1.5
"""A turned rectangle is taken before two that leave little less: it is one touch."""

# An L as one body: paper_mm 0.003, and the 95th percentile of its times from 0.1 s to 1.8 s without.

MAX_CRACK_MM: Final = 3.0
"""Between two shapes of one touch: less than a pixel."""

JOINT_CRACK_SD_MM: Final = 0.3

JOINT_CONTRAST_SD: Final = 0.05
"""Of the difference of two shapes' log contrasts."""

MAX_CHI2_PER_JOINT: Final = 10.0
"""Largest increase of the residual by a joint: one of a hundred bodies exceeds it, as with two degrees of freedom."""

# Usual contrast tried outright: 0.004.

MIN_LOG_RATIO_TO_USUAL_CONTRAST: Final = 0.5

MAX_AREA_RATIO_OF_RESCALED: Final = 5.0

# Ellipses: lab-like presses 0.007; of ellipses across the sheet, 11 of 20 are flagged though right without.

# Two in place of one: pairs seen at rest 0.020, two of 24 pairs on bumps.

MIN_ASPECT_OF_TWO: Final = 1.2

GAP_OF_TWO_MM: Final = 10.0
"""Between the two, at first."""

MIN_LOG_RATIO_OF_WEAK_TOUCH: Final = 1.0
"""A touch whose log contrast is weaker than usual by more is tried as two of usual contrast."""

MIN_GAIN_OF_TWO: Final = 20.0
"""If the one touch is not weak."""

MAX_LOG_RATIO_OF_SAME_SIDES: Final = 0.25
"""Up to which the network's map shows a touch as large as it was found: then it is one. Worth time alone: without this,
ellipses across the sheet take 115 ms for 69."""

MAX_AREA_OF_GHOST_MM2: Final = 12.0
"""Of a touch that is tried to be left out: a ghost of the network shrinks to it. A sheet stretched beyond the training
0.08."""

# Gentler contrasts: contrast 2 0.083, contrast 3 of 16 mm 0.136; lab-like singles lose 0.013 by them.

GENTLER_RAISING: Final = ((1.5, 0.1), (2.0, 0.1), (3.0, 0.1), (5.0, 0.1))
"""Contrasts, and the share of belief of each, of small touches that raise conductance."""

LARGE_GENTLER_CONTRASTS: Final = ((2.0, 0.05), (3.0, 0.05))
"""The same of larger ones that are alone."""

GENTLER_LOWERING: Final = ((0.7, 0.4),)
"""The same of touches that lower conductance."""

MAX_ROOT_AREA_OF_GENTLER_MM: Final = 8.5
"""Root of the area from which a touch of contrast 50 reads otherwise than any of contrast 5,"""

MAX_ROOT_AREA_OF_GENTLER_LARGE_MM: Final = 20.0
"""and than any of contrast 2, of twice the side."""

HELD_CONTRAST_SD: Final = 0.05
"""Of the mean log contrast about one that is tried."""

STEPS_PER_CONTRAST: Final = 3

MAX_COST_OF_GENTLER: Final = 8.0
"""Over the fit's own, as derivatives promise it: beyond, gentler contrasts are not tried."""

MIN_SHARE_OF_BELIEF: Final = 0.02

# Touches of both signs: pairs of opposite signs 20 mm apart 0.6 without.

MIN_MISFIT_WITHOUT_NETWORK: Final = 4.0
"""Chi-squared over rows from which the network's touches are left, and touches found one by one."""

PLACES_MM: Final = 5.0
"""Between two places where one more touch is tried."""

MIN_SHARE_BESIDE: Final = 0.1
"""Of a touch's response that the touches found cannot imitate, below which it is not told from them."""

SIDES_OF_ANOTHER_MM: Final = (6.0, 30.0)
"""Between which it starts."""

MAX_TOUCHES_ONE_BY_ONE: Final = 4

# What a fit says of its errors.

MIN_CURVATURE_SHARE: Final = 1e-12
"""Of the curvature along what is known best."""

RANGE_SD: Final = 2.0
"""Standard deviations of the ranges of area and contrast."""

OVERLAP_MM: Final = 0.5
"""Touches that overlap by more share pixels in the map, and one is a part of two in place of the other."""

# The sheet's model.

ELEMENT_MM: Final = 4.5
"""The largest element: fitted centres are off by up to 0.1 mm by it, sizes by 0.2 mm."""

MESH_ERROR: Final = 1e-3
"""Independent error of each row, of V over V0. A floor of 2 % hides wrong answers: keep it this low."""

MIN_SD_OF_DV: Final = 1e-5
"""A row at nearly 0 V is still read by a converter."""

VOLTAGE_RATIO_BOUNDS: Final = (0.3, 3.0)
"""Of a frame's V over the untouched model's, by which what may differ is scaled row by row."""

DRIFT_SD: Final = 0.05

TILT_SD: Final = 0.01

GAUGE_SD: Final = 0.5

SCAN_NOISE_MM: Final = 0.1
"""Of a scanner, where the skin does not say."""

GOOD_SCAN_MM: Final = 0.4
"""Noise of a scan up to which it is taken as it is: as members of the family, scans of 0.1 mm lost one of 20 pairs of
opposite signs and one of 40 lab-like presses."""

MAX_SCAN_NOISE_MM: Final = 2.0
"""More is not believed: a cloud that is so far off is of another surface."""

MIN_SCAN_WAY_SHARE: Final = 0.01
"""Ways in which a scan's noise changes voltages by less, of the strongest, are none."""

# The model made again: two pairs of 24, eight lab-like maps flagged though right.

MAX_LINEAR_STRETCH: Final = 0.02
"""Up to which derivatives are good enough."""

MAX_LINEAR_GAUGE: Final = 0.2

MAX_MODELS_PER_DEFORMATION: Final = 4

MAX_COST_RATIO_OF_MODEL_MADE_AGAIN: Final = 0.7
"""Of the cost of a frame that it does not explain: a frame that is nonsense leaves the model as it is."""

# Other sheets where nothing explains a frame: the 95th percentile of lab-like times from 0.3 s to 1.9 s without.

MAX_RMS_OF_LIKELY_SHEET: Final = 2.0
"""Standard deviations of stretch, gauge and drift."""

ROW_ERROR_PER_MISFIT: Final = 3.0
"""Times that a row may be off by more, by the root of what chi-squared has more than rows, for each of them."""

MIN_P_OF_OTHER_SHEET: Final = 1e-3
"""From which another sheet is gone on with."""

# Where material lies under a scan: three pairs of 24; bumps: lab-like singles 0.010.

MOVED_METRIC_GRID_MM: Final = 2.5
"""Of the points between which a moved metric is a spline: its own knots are eight times further apart."""

WAVE_SPREADS: Final = (
    (
        (0.006, 0.045, 0.005), (0.072, 0.008, 0.004), (0.004, 0.006, 0.004), (0.004, 0.003, 0.003),
        (0.0015, 0.002, 0.002), (0.0015, 0.0015, 0.002),
    ),
    ((0.008, 0.085, 0.012), (0.008, 0.02, 0.008), (0.003, 0.01, 0.005), (0.003, 0.004, 0.002)),
)  # fmt: skip
"""Standard deviations of the waves along x and along y: half waves 1, 2, ..; across each, polynomials of order 0 to 2.

As found of 40 deformations each of the families A and B, from the metrics of sheets and of their clouds: uneven stretch
along the sheet is wave 2, order 0 along x; twist is wave 1, order 1 along both. The others are bumps.
"""

USUAL_WAVES_SEED: Final = 44_217

USUAL_WAVES_DRAWS: Final = 32
"""Deformations that the process learns from, each with its mirror images: a second once a process and skin."""

USUAL_WAVES_STEPS: Final = 3
"""Derivatives taken until a metric is met."""

METRIC_PLACES: Final = (24, 16)
"""Places along x and y where a metric is compared."""

METRIC_COMPONENTS: Final = 20
"""Principal components of the metrics that a scan shows."""

METRIC_NOISE_RMS: Final = 0.015
"""What 0.1 mm of noise makes of a component: one that varies less than that says little."""

SHAPE_KERNEL_LENGTH: Final = 15.0
"""Of the process's kernel exp(-d^2 / 2 length^2), d in standard deviations of all components together."""

SHAPE_KERNEL_NUGGET: Final = 0.03
"""Variance of what the shape does not say, over the process's own: a third of it or three times it misses no less."""

WAVE_SD_SHARE_ALWAYS: Final = 0.1
"""Share of its spread that every wave has for itself,"""

WAVE_SD_SHARE_OF_UNLIKE_SHAPE: Final = 0.35
"""and under a shape unlike those drawn."""

BUMPS_RMS_OF_FREE_MATERIAL: Final = 0.0125
"""Of a metric beyond the components, with which every wave has its whole spread: of 100 deformations of family B."""

MAX_CURVATURE_PER_MM2: Final = 8e-4
"""Largest Gaussian curvature of a scan up to which its material is where the model has it: beyond, 3 of 16 touches
beside a dent of 10 mm were off by over 2 mm, and explained."""

# A sheet seen at rest: paper-like touches from 0.997 to 0.994 without, pairs from 0.953 to 0.923.

MAX_MODELS_AT_REST: Final = 8
"""Times that a model is made again about what the untouched sheet reads."""

MAX_EXCESS_AT_REST: Final = 5.0
"""Times that more may be off at rest than was thought: beyond it is another sheet."""

MODEL_ERROR_SHARE_OF_TOUCH: Final = 0.25
"""Part of what a model may be off by that a touch may change."""

ROW_ERROR_BY_TOUCH: Final = 0.1
"""Part of what was seen beside the model, row by row, that a touch may change."""

# A shape that nothing scanned.

SEARCH_LOG_SDS: Final = (0.06, 0.03, 0.015, 0.008, 0.005, 0.0)
"""Standard deviations of log V by which rows are believed less, model after model; the last holds on."""

SEARCH_MAX_MODELS: Final = 14

SEARCH_MIN_STEP: Final = 0.2
"""An amplitude's largest step from a model that is the last, in standard deviations."""

SEARCH_STEPS: Final = 2
"""With each model."""

SEARCH_MAX_STEP: Final = 1.0
"""Of every amplitude away from a model, in standard deviations."""

DICTIONARY_MM: Final = 7.0
"""Between places of touches that a search starts from."""

DICTIONARY_LOG_SD: Final = 0.03
"""Of rows, whose columns are those of the mean shape."""

DICTIONARY_STRENGTH_SD: Final = 0.5
"""Of the strength of a touch over the usual."""

DICTIONARY_TOUCHES: Final = 6
"""The most that are chosen,"""

DICTIONARY_APART_MM: Final = 16.0
"""and how far apart they are at least."""

MAX_EXCESS_OF_GUESS: Final = 1.5
"""Times that more may be off at rest than was thought, for a shape that nothing scanned."""

ALIKE_MM: Final = 8.0
"""Starts whose touches are nearer to each other end alike."""

# Units: a map of units is snapped from shapes. 16 of 16 sets of paper_units, 94 of 97 sets of 1 to 6 units at random.

MAX_UNITS: Final = 6
"""That the network shows where units are verified: sets of 7 to 10 came out right in 4 of 9 frames."""

MIN_COVERED_SHARE: Final = 0.5
"""Of a touched unit, by the verified map."""

COVERED_SHARES_IN_DOUBT: Final = (0.1, 0.9)
"""Between which a unit may be touched or not."""

MAX_UNITS_IN_DOUBT: Final = 10
"""That are put in or taken out, those nearest to ``MIN_COVERED_SHARE``."""

MIN_P_OF_SURE_UNITS: Final = 0.5
"""From which a set is left as it is. As p is cautious, most right sets reach it."""

COST_OF_UNIT: Final = 6.0
"""Chi-squared that a unit must explain."""

MODEL_ERROR_OF_UNITS: Final = 0.01
"""Error of the model as a share of the units' change."""

MAX_STEPS_OF_UNITS: Final = 6
"""Of a fit of their contrasts."""
