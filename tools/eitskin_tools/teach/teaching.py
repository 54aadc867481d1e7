"""Teaches a sheet: learns its field, sets the gate, and measures both on presses that it was not taught.

The presses are divided into stretches of time. Each is left out once, and the field that the others give places its
presses, through the code that runs in a stream. That gives the error of the place, and a factor for its stated standard
deviations, with which 68 % of x and of y lie within one. Fields of a half and of a quarter of the presses say what more
of them would bring.
"""

from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist, mean, stdev
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.model.response_field import ResponseField
from eitskin.model.taught import TaughtField
from eitskin_proto.files.arrays import Array
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.parts import Map, Outline, Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import Skin
from eitskin_tools.teach import physics
from eitskin_tools.teach.presses import FEWEST, Presses, PressesError, check_teachable
from eitskin_tools.teach.response import FREEDOM, Response, dependence_on_place, learn
from eitskin_tools.teach.shapes import check_shapes, level_arrays

FOLDS: Final = 5
"""Parts of the cross-validation."""

PIXELS: Final = 1350
"""Of the map, about, where no skin's file says otherwise."""

WITHIN: Final = 0.68
"""Share of x and of y within one stated standard deviation."""

SPREADS: Final = (0.3, 4.0)
"""Bounds of the factor that brings that about."""

DRAWS: Final = 5000
"""Untouched frames that are drawn to set the gate."""

MOST_LEFT: Final = 1.5
"""What touches leave of a frame in a known shape at most, over the most that they leave of a press that was taught."""

FASTEST: Final = 0.7
"""Least error of twice as many presses, over the present one: that of errors that average out."""

ENOUGH: Final = 16
"""Presses from which one that is left out must be placed better than in the middle of the others."""

FELT: Final = 0.75
SURELY_FELT: Final = 0.95
"""Share of shuffled places that own places must surpass, with enough presses and with fewer, which have no other test.
Many faint presses are not refused by chance."""

NOT_FELT: Final = (
    "the presses are not felt: their readings do not depend on the place; press harder, or check that places and "
    "readings belong together"
)

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, eq=False)
class Taught:
    """What was learned, and how good it is."""

    skin: Skin
    arrays: Arrays
    """Of taught.npz."""
    report: dict[str, Any]
    """For the card."""
    places_mm: Array
    """(presses, 2)"""
    errors_mm: Array
    """(presses,) of the cross-validation."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Readings as a field judges them, each by itself."""

    place_mm: Array
    """(n, 2)"""
    sd_mm: Array
    """(n, 2)"""
    margin: Array
    """(n,) logit above the threshold of the gate."""
    left: Array
    """(n,) squared length of what touches leave."""


def teach(
    presses: Presses, skin: Skin | None, false_alarms: float, tell: Callable[[str], None] = lambda _: None
) -> Taught:
    """Return what a sheet is taught by presses.

    Args:
        presses: Of the sheet.
        skin: Its description; None makes one with electrodes evenly round the border.
        false_alarms: Share of untouched frames that may look touched.
        tell: Told what is being done.

    Raises:
        PressesError: The presses are too few, in one place, or not felt; or the skin is another one.
    """
    check_teachable(presses)
    skin = fitting(presses, skin)
    changes, places = presses.logarithms()[presses.pressed], presses.xy_mm[presses.pressed]
    untouched = untouched_changes(presses)
    if dependence_on_place(changes, places, presses.size_mm) < (FELT if len(places) >= ENOUGH else SURELY_FELT):
        raise PressesError(NOT_FELT)
    known = physics.applies(skin, presses.table)
    prior = physics.expected_changes(skin, places) if known else None

    def learned(chosen: npt.NDArray[np.intp]) -> tuple[Response, Arrays]:
        expected = None if prior is None else prior[chosen]
        response = learn(changes[chosen], places[chosen], presses.size_mm, expected)
        return response, _arrays(response, presses, skin, untouched)

    tell("learning the field")
    everything = np.arange(len(places))
    response, arrays = learned(everything)
    tell("placing presses that were left out")
    folds = np.random.default_rng(0).permutation(int(presses.blocks.max()) + 1)[presses.blocks] % FOLDS
    placed = Placed(np.zeros_like(places), np.ones_like(places), *np.zeros((2, len(places))))
    for fold in np.unique(folds):
        out = np.flatnonzero(folds == fold)
        part = place(TaughtField([learned(np.setdiff1d(everything, out))[1]], skin.grid), changes[out])
        placed.place_mm[out], placed.sd_mm[out], placed.margin[out] = part.place_mm, part.sd_mm, part.margin
        placed.left[out] = part.left
    spread = float(np.clip(np.quantile(np.abs(placed.place_mm - places) / placed.sd_mm, WITHIN), *SPREADS))
    errors = np.hypot(*(placed.place_mm - places).T)
    if len(places) >= ENOUGH and np.median(errors) > np.median(np.hypot(*(places - places.mean(axis=0)).T)):
        raise PressesError(NOT_FELT)
    arrays["spread"] = np.array(spread)
    arrays["most_left"] = np.array(MOST_LEFT * placed.left.max())
    arrays["threshold"] = np.array(_threshold(arrays, untouched, false_alarms, skin.grid))
    curve = {}
    for count in (len(places) // 4, len(places) // 2):
        if count >= FEWEST:
            some = np.random.default_rng(count).permutation(len(places))
            field = TaughtField([learned(np.sort(some[:count]))[1]], skin.grid)
            rest = some[count:][:200]
            found = place(field, changes[rest])
            curve[count] = float(np.median(np.hypot(*(found.place_mm - places[rest]).T)))
    curve[len(places)] = float(np.median(errors))
    report = {
        "presses": len(places),
        "untouched": int((~presses.pressed).sum()),
        "rows": presses.table.rows,
        "localisation_median_mm": float(np.median(errors)),
        "localisation_p90_mm": float(np.quantile(errors, 0.9)),
        "missed": float((placed.margin <= arrays["threshold"]).mean()),
        "stated_within_1sd": float((np.abs(placed.place_mm - places) < spread * placed.sd_mm).mean()),
        "false_alarms": false_alarms,
        "presses_and_median_mm": {str(count): round(one, 3) for count, one in curve.items()},
        "twice_as_many_mm": _twice(curve),
        "length_mm": round(response.length_mm, 2),
        "directions": int(arrays["project"].shape[1]),
        "amplitude_sd": round(response.amplitude_sd, 3),
        "physics_weight": round(response.prior_weight, 3),
        "physics_tried": prior is not None,
        "touches": _touch_kind(response, changes),
    }
    taught = Taught(skin, arrays, report, places, errors)
    near = error_map(taught, places)
    report["weakest_mm"], report["weakest_error_mm"] = places[near.argmax()].tolist(), float(near.max())
    return taught


def teach_shapes(
    shapes: dict[str, Presses], skin: Skin | None, false_alarms: float, tell: Callable[[str], None] = lambda _: None
) -> dict[str, Taught]:
    """Return what a sheet is taught in each of its shapes, and how they are told apart.

    Args:
        shapes: Presses in each, by its name.
        skin: As in :func:`teach`.
        false_alarms: As in :func:`teach`.
        tell: Told what is being done.

    Raises:
        PressesError: Presses cannot be taught, or are not of one sheet.
    """
    check_shapes(shapes)
    found = {}
    for name, one in shapes.items():
        try:
            found[name] = teach(one, skin, false_alarms, tell)
        except PressesError as error:
            raise PressesError(f"{name}: {error}") from error
    levels = level_arrays(list(shapes.values()), [taught.arrays for taught in found.values()])
    for taught, arrays in zip(found.values(), levels, strict=True):
        taught.arrays.update(arrays)
    return found


def place(field: TaughtField, logarithms: Array, untouched_V: Array | None = None) -> Placed:
    """Return where a field finds one press in each reading, whether its gate is open or not.

    Args:
        field: Of a bundle, or a part of one.
        logarithms: (n, rows) as :meth:`Presses.logarithms`.
        untouched_V: (n, rows) against which they are held, which shows the shape; None for that of the field.
    """
    n = len(logarithms)
    found = Placed(*np.zeros((2, n, 2)), *np.zeros((2, n)))
    for index, one in enumerate(np.expm1(logarithms) if field.logarithmic else logarithms):
        if untouched_V is not None:
            field.use_reference(untouched_V[index])
        field.change[:] = one
        found.margin[index] = field.look() - field.threshold
        found.left[index] = field.left()
        touch = field.strongest()
        found.place_mm[index], found.sd_mm[index] = (touch.x_mm, touch.y_mm), (touch.sd_x_mm, touch.sd_y_mm)
    return found


def error_map(taught: Taught, places_mm: Array) -> Array:
    """Return (m,) the error of presses near some places: their mean, weighted by distance.

    Args:
        taught: With the errors of the cross-validation.
        places_mm: (m, 2)
    """
    reach = 0.12 * min(taught.skin.outline.size_mm)
    squares = ((places_mm[:, None] - taught.places_mm) ** 2).sum(axis=-1)
    weights = np.exp(squares / (-2.0 * reach**2)) + 1e-12
    return np.asarray(weights @ taught.errors_mm / weights.sum(axis=1))


def untouched_changes(presses: Presses) -> Array:
    """Return (m, rows) changes of untouched readings, each against the one before it."""
    return presses.logarithms()[~presses.pressed][1:]


def fitting(presses: Presses, skin: Skin | None) -> Skin:
    """Return the skin of the file, or one of its size.

    Raises:
        PressesError: It is another sheet.
    """
    if skin is not None:
        if skin.outline.kind != presses.outline or not np.allclose(skin.outline.size_mm, presses.size_mm, atol=0.5):
            length, width = skin.outline.size_mm
            raise PressesError(
                f"the presses have {presses.sheet}, expected the skin's {skin.outline.kind} of {length:g} x {width:g} "
                "mm; name the skin that was pressed"
            )
        return skin
    outline = Outline(presses.outline, presses.size_mm)
    pitch = (presses.size_mm[0] * presses.size_mm[1] / PIXELS) ** 0.5
    columns, rows = (int(np.clip(round(size / pitch), 6, 120)) for size in presses.size_mm)
    steps = (np.arange(N_ELECTRODES) + 0.4) / N_ELECTRODES
    ring = Ring(arc_length_mm=Quantity(tuple(float(one) for one in outline.perimeter_mm * steps)))
    return Skin(name="taught", outline=outline, electrodes=ring, map=Map(shape=(rows, columns)))


def _arrays(response: Response, presses: Presses, skin: Skin, untouched: Array) -> Arrays:
    """Return the arrays of taught.npz, with a gate and errors that are not set yet."""
    centres = skin.grid.pixel_centres_mm().reshape(-1, 2)
    size = np.array(presses.size_mm)
    inside = np.ones(len(centres), dtype=bool)
    if presses.outline == "disc":
        inside = (((centres - size / 2.0) / (size / 2.0)) ** 2).sum(axis=1) < 1.0
    prior = physics.expected_changes(skin, centres) if response.prior_weight else None
    if prior is None:  # nothing is known of places beyond the presses
        inside &= _within(centres, response.places_mm)
    field, variance = response.at(centres, prior)
    if not field.shape[1]:
        raise PressesError(NOT_FELT)
    return {
        "project": response.project.astype(np.float32),
        "field": field.astype(np.float32),
        "variance": variance.astype(np.float32),
        "inside": inside,
        "untouched": _noise(untouched @ response.project),
        "amplitude_sd": np.array(response.amplitude_sd),
        "freedom": np.array(FREEDOM),
        "threshold": np.array(0.0),
        "spread": np.array(1.0),
        "logarithm": np.array(presses.logarithmic),
    }


def _within(places_mm: Array, presses_mm: Array) -> npt.NDArray[np.bool_]:
    """Return whether places lie in the convex hull of presses, wider by half of the presses' usual distance."""
    angles = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    outwards = np.stack([np.cos(angles), np.sin(angles)])
    margin = 0.5 * float(np.sqrt(np.prod(np.ptp(presses_mm, axis=0)) / len(presses_mm)))
    return np.asarray((places_mm @ outwards <= (presses_mm @ outwards).max(axis=0) + margin).all(axis=1))


def _threshold(arrays: Arrays, untouched: Array, false_alarms: float, grid: Grid) -> float:
    """Return the logit that untouched frames exceed with the probability ``false_alarms``.

    It is the quantile of frames that are drawn by the untouched noise, and of measured ones where those say more. Each
    of few measured ones is judged by the noise of the others; a normal distribution of their logits gives the tail.
    """
    field, rng = ResponseField(arrays, grid), np.random.default_rng(0)
    root = np.linalg.cholesky(arrays["untouched"])
    drawn = rng.normal(size=(DRAWS, len(root))) @ root.T / np.sqrt(rng.chisquare(FREEDOM, (DRAWS, 1)) / FREEDOM)
    drawn_logits = [field.judge(one) for one in drawn.astype(np.float32)]
    threshold = float(np.quantile(drawn_logits, 1.0 - false_alarms))
    noise = (untouched @ arrays["project"]).astype(np.float32)
    if len(noise) * false_alarms >= 1.0:
        return max(threshold, float(np.quantile([field.judge(one) for one in noise], 1.0 - false_alarms)))
    if len(noise) < FEWEST:
        return threshold
    logits = []
    for index, one in enumerate(noise):
        others = {"untouched": _noise(np.delete(noise, index, axis=0))}
        logits.append(ResponseField({**arrays, **others}, grid).judge(one))
    return max(threshold, NormalDist(mean(logits), stdev(logits)).inv_cdf(1.0 - false_alarms))


def _noise(untouched: Array) -> Array:
    """Return the covariance of untouched frames, along the axes: that of presses, the identity, where few are known."""
    q = untouched.shape[1]
    return np.asarray((untouched.T @ untouched + q * np.eye(q)) / (len(untouched) + q))


def _touch_kind(response: Response, changes: Array) -> str:
    """Return which way presses change conductance: physics says so where it applies; else most readings do."""
    sign = response.prior_weight or -float(changes.mean(axis=1).sum())
    return "raise" if sign > 0.0 else "lower"


def _twice(curve: dict[int, float]) -> float:
    """Return the median error that twice as many presses would have, if it goes on falling as it did."""
    *before, last = curve.values()
    return last * float(np.clip(last / before[-1], FASTEST, 1.0)) if before else last
