"""The prior probability of touches.

Costs are -2 log of a probability, so they add to a chi-squared. All but the first are squares of residuals, which a fit
minimises together with those of the frame::

    number      each touch costs 2 log(places / expected touches)
    size        log sqrt(area), normal about that of the skin's touches
    aspect      log(length / width), normal about 0
    contrast    its logarithm: the mean of all touches of one sign about that of the skin's, each touch about this mean
    border      the width of a graded border
    joints      shapes that are one touch, as an L is two rectangles, have no crack between them and the same contrast

Without joints the arms of an L grow and shrink against each other: a crack of a millimetre, or two contrasts, answer
nearly as the whole does. Shapes that overlap cost nothing.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.parts import Range
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.arrays import Array
from eitskin_sim.shapes.parameters import ANGLE, BORDER, HALF_LENGTH, HALF_WIDTH, LOG_CONTRAST, X, free, parameters_of
from eitskin_sim.verification import constants as c

Joints = tuple[tuple[int, int], ...]
"""Numbers of upright rectangles that are one touch, in pairs."""

Free = npt.NDArray[np.bool_]
"""(n, 7) which parameters of touches are fitted."""


@dataclass(frozen=True, slots=True)
class TouchPrior:
    """The distribution of a skin's touches: means and standard deviations."""

    log_contrasts: tuple[float, float]
    """Means over all touches of a frame that raise conductance, and over those that lower it."""
    mean_contrast_sds: tuple[float, float]
    """Of the two means."""
    sign: int
    """Of every log contrast: 1 where touches raise conductance, -1 where they lower it, 0 where both happen."""
    size_mm: float
    """Median of sqrt(area)."""
    size_log_sd: float
    per_touch: float = 2.0 * float(np.log(c.DISTINCT_PLACES / c.EXPECTED_TOUCHES))
    """Cost of one more touch."""

    def usual(self, signs: Array) -> Array:
        """Return (n,) usual log contrasts of touches of some signs (n,): below 0 where they lower conductance."""
        return np.where(signs < 0.0, self.log_contrasts[1], self.log_contrasts[0])

    def residuals(self, pieces: Array, fitted: Free, joints: Joints = ()) -> Array:
        """Return (p,) residuals; the last two are those of the mean contrasts.

        Args:
            pieces: (n, 8) touches.
            fitted: Which parameters are.
            joints: Which of the touches hang together.
        """
        if not len(pieces):
            return np.zeros(0)
        values = parameters_of(pieces)
        length, width, log = values[:, HALF_LENGTH], values[:, HALF_WIDTH], values[:, LOG_CONTRAST]
        mean, alike = by_sign(log)
        return np.concatenate(
            [
                0.5 * np.log(4.0 * length * width / self.size_mm**2) / self.size_log_sd,
                np.log(length / width) / c.ASPECT_LOG_SD,
                (log - alike @ log) / c.OWN_CONTRAST_SD,
                (values[fitted[:, BORDER], BORDER] - c.BORDER_MM) / c.BORDER_SD_MM,
                _joint_residuals(values, joints),
                (mean @ log - mean.sum(axis=1) * self.log_contrasts) / self.mean_contrast_sds,
            ]
        )

    def jacobian(self, pieces: Array, fitted: Free, joints: Joints = ()) -> Array:
        """Return the (p, r) derivatives of :meth:`residuals` by the fitted parameters."""
        n = len(pieces)
        if not n:
            return np.zeros((0, 0))
        values, each, graded = parameters_of(pieces), np.arange(n), np.flatnonzero(fitted[:, BORDER])
        length, width = values[:, HALF_LENGTH], values[:, HALF_WIDTH]
        of_joints = _joint_jacobian(values, joints)
        mean, alike = by_sign(values[:, LOG_CONTRAST])
        by = np.zeros((3 * n + len(graded) + len(of_joints) + 2, *fitted.shape))
        by[each, each, HALF_LENGTH] = 0.5 / length / self.size_log_sd
        by[each, each, HALF_WIDTH] = 0.5 / width / self.size_log_sd
        by[n + each, each, HALF_LENGTH] = 1.0 / length / c.ASPECT_LOG_SD
        by[n + each, each, HALF_WIDTH] = -1.0 / width / c.ASPECT_LOG_SD
        by[2 * n : 3 * n, :, LOG_CONTRAST] = (np.eye(n) - alike) / c.OWN_CONTRAST_SD
        by[3 * n + np.arange(len(graded)), graded, BORDER] = 1.0 / c.BORDER_SD_MM
        by[3 * n + len(graded) : -2] = of_joints
        by[-2:, :, LOG_CONTRAST] = mean / np.array(self.mean_contrast_sds)[:, None]
        return np.asarray(by[:, fitted])


def touch_prior(kind: TouchKind, skin: Skin = PAPER) -> TouchPrior:
    """Return the prior of a skin whose touches go one way, or both: contrasts and sizes that its file states."""
    log_size, size_sd = _log_uniform(skin.touches.size_mm)
    size = {"size_mm": float(np.exp(log_size)), "size_log_sd": float(np.hypot(size_sd, c.SIZE_LOG_SD_BEYOND_SKIN))}
    raising, lowering = (_log_uniform(one) for one in (skin.touches.raising_contrast, skin.touches.lowering_contrast))
    sds = [float(np.hypot(sd, c.CONTRAST_LOG_SD_BEYOND_SKIN)) for _, sd in (raising, lowering)]
    return TouchPrior((raising[0], lowering[0]), (sds[0], sds[1]), {"raise": 1, "lower": -1, "both": 0}[kind], **size)


def by_sign(log_contrasts: Array) -> tuple[Array, Array]:
    """Return (2, n) weights that average the touches that raise and those that lower; and (n, n), each touch's."""
    lowers = log_contrasts < 0.0
    each = np.array([~lowers, lowers], dtype=np.float64)
    mean = each / np.maximum(each.sum(axis=1, keepdims=True), 1.0)
    return mean, each.T @ mean


def _log_uniform(stated: Range) -> tuple[float, float]:
    """Return mean and standard deviation of the logarithm of what is log-uniform within a range."""
    low, high = np.log(stated)
    return float((low + high) / 2.0), float((high - low) / np.sqrt(12.0))


def fitted_parameters(pieces: Array, turning: bool) -> Free:
    """Return which parameters of touches are fitted: angles only if they are to turn."""
    found = free(pieces)
    found[:, ANGLE] &= turning
    return found


def crack_mm(values: Array, pair: tuple[int, int]) -> tuple[float, int]:
    """Return how far two upright rectangles are apart, below 0 where they overlap, and along which axis."""
    i, j = pair
    apart = np.abs(values[i, :2] - values[j, :2]) - (values[i, 2:4] + values[j, 2:4])
    axis = int(np.argmax(apart))
    return float(apart[axis]), axis


def _joint_residuals(values: Array, joints: Joints) -> Array:
    """Return (2 j,) residuals of j joints: cracks, then differences of log contrasts, by (n, 7) parameters."""
    cracks = [max(crack_mm(values, pair)[0], 0.0) / c.JOINT_CRACK_SD_MM for pair in joints]
    unlike = [(values[i, LOG_CONTRAST] - values[j, LOG_CONTRAST]) / c.JOINT_CONTRAST_SD for i, j in joints]
    return np.array(cracks + unlike)


def _joint_jacobian(values: Array, joints: Joints) -> Array:
    """Return (2 j, n, 7) derivatives of the same by the parameters."""
    found = np.zeros((2 * len(joints), *values.shape))
    for number, (i, j) in enumerate(joints):
        wide, axis = crack_mm(values, (i, j))
        if wide > 0.0:
            way = np.sign(values[i, X + axis] - values[j, X + axis]) / c.JOINT_CRACK_SD_MM
            found[number, [i, j], X + axis] = way, -way
            found[number, [i, j], HALF_LENGTH + axis] = -1.0 / c.JOINT_CRACK_SD_MM
        found[len(joints) + number, [i, j], LOG_CONTRAST] = 1.0 / c.JOINT_CONTRAST_SD, -1.0 / c.JOINT_CONTRAST_SD
    return found
