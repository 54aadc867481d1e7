"""Finds touches by what a sheet was taught, in one shape or several: the shape, the averages and the drift.

``eitskin teach`` learns from recorded presses the *response field* (:mod:`eitskin.model.response_field`), one for each
shape in which the sheet was pressed, and the level of its untouched rows. At run time ::

    change = log(V / V_reference) = level of the shape - level of the reference + drift + touch + noise

The *shape* is the one whose level is nearest. Presses, drift and noise count as noise of that distance, so a press is
not taken for a bend. V_pred is one more candidate: with it the shape is the reference's, and the level predicted. If
none of them is near, the shape is unknown.

Two means are kept of frames. While the sheet is still, frames are averaged. While it is untouched, the *baseline*
follows it, so drift does not look like a touch; it stays while the sheet is touched, however long.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.model.bundle import Bundle
from eitskin.model.response_field import HINT, LARGEST, ResponseField, TaughtTouch, finite
from eitskin.touches.moments import Found
from eitskin_proto.skin.grid import Grid

MOST_AVERAGED: Final = 50
"""Frames of a still sheet that are averaged; older ones fade."""

RESTART: Final = 4.0
"""A frame starts a new average if its squared distance from it exceeds the usual by this factor."""

NOISE_STEP: Final = 0.05
"""Share by which the estimate of the frames' noise moves with each frame, towards the median of what is seen."""

FIRST_STEPS: Final = 4
"""Steps between frames of which the smallest is the first estimate: one of them may be a press."""

FOLLOW_FRAMES: Final = 32
"""The baseline follows after so many untouched frames."""

FOLLOW_SHARE: Final = 0.5
"""Part of the way to their mean that it goes."""

RELEASED: Final = 0.02
"""A still frame with less than this share of the touch's largest squared response is the untouched sheet again."""

SMALLEST_RATIO: Final = 1e-6
"""V / V0 is not taken for less before the logarithm."""

NEARER: Final = 20.0
"""Squared distance by which the level of another shape must be nearer: a log likelihood of ten."""

PREDICTED: Final = "predicted"
"""The shape of a frame whose untouched level V_pred explains better than any that was taught."""

UNKNOWN: Final = "unknown"
"""The shape of a frame whose level is like none of them."""

Arrays = Mapping[str, npt.NDArray[np.generic]]


class TaughtField:
    """Judges frames and places touches: fill ``change``, call :meth:`touched`, then ask for the map or the touches.

    Args:
        shapes: Arrays of taught.npz for each shape (:class:`~eitskin.model.response_field.ResponseField`), and: level
            (rows,) log |V| of its untouched sheet, 0 where a row has none. The first may have white (rows, r), in which
            presses, drift and noise have unit variance, and reach, the largest squared length there of a known shape.
        grid: Of the skin's map.
        names: Of the shapes.

    Raises:
        BundleError: An array is missing, has a wrong shape, is not finite or out of range.
    """

    def __init__(self, shapes: Sequence[Arrays], grid: Grid, names: Sequence[str] = ()) -> None:
        self._fields = [ResponseField(one, grid) for one in shapes]
        self.rows = rows = self._fields[0].rows
        """n, of a frame."""
        self.logarithmic = self._fields[0].logarithmic
        """Whether it was taught logarithms of V / V_untouched, not changes of another unit."""
        if any((one.rows, one.logarithmic) != (rows, self.logarithmic) for one in self._fields):
            raise BundleError(f"taught.npz: shapes differ in their rows or their unit; {HINT}")
        self._names = (*(names or ["taught"]), PREDICTED)
        if len(self._names) != len(shapes) + 1:
            raise BundleError(f"manifest.json names {len(names)} shapes, expected {len(shapes)}; {HINT}")
        blank = {"level": np.zeros(rows), "white": np.zeros((rows, 0)), "reach": np.array(LARGEST)}
        self._levels = np.stack([finite({**blank, **one}, "level", (rows,)) for one in shapes])
        self._white = finite({**blank, **shapes[0]}, "white", (rows, None)).astype(np.float32)
        self._reach = float(finite({**blank, **shapes[0]}, "reach", ()))
        self._offsets = np.zeros((len(shapes) + 1, rows), np.float32)
        """Levels against the reference's; the last one is predicted."""
        self._centres, self._apart = np.zeros((2, len(shapes) + 1, self._white.shape[1]), np.float32)
        self._at, self._distances = self._centres[0].copy(), np.zeros(len(shapes) + 1, np.float32)
        self.change = np.zeros(rows, np.float32)
        """(rows,) dV against the reference, to be filled before :meth:`touched`."""
        self._values, self._last, self._mean, self._rest, self._baseline = np.zeros((5, rows), np.float32)
        self.logit = 0.0
        """Log of how much likelier than untouched the last frame is."""
        self.threshold = 0.0
        """The logit above which a frame counts as touched."""
        self._home = 0
        self.use_reference(np.zeros(rows))
        self.reset()

    @property
    def shape(self) -> str:
        """The name of the shape in which the sheet is, or ``predicted``, or ``unknown``."""
        return UNKNOWN if self._unlike else self._names[self._shape]

    def use_reference(self, voltages_V: npt.NDArray[np.float64]) -> None:
        """Find the shape in which the reference was taken, from which the levels of the others are counted.

        Args:
            voltages_V: (rows,), 0 where a row carries no information.
        """
        known = (voltages_V != 0.0) & (self._levels != 0.0).all(axis=0)
        if known.any():
            apart = np.where(known, self._levels - np.log(np.abs(np.where(known, voltages_V, 1.0))), 0.0)
            apart -= np.where(known, np.median(apart[:, known], axis=1, keepdims=True), 0.0)  # another current
            self._home = int(((apart @ self._white) ** 2).sum(axis=1).argmin())
        self._offsets[:-1] = np.where(known, self._levels - self._levels[self._home], 0.0)
        self.use_prediction(self._offsets[self._home])
        self._use(self._home)

    def use_prediction(self, log_predicted: npt.NDArray[np.float32]) -> None:
        """Take the level that the forward model predicts, (rows,) log(V_pred / V_reference); zeros for none."""
        self._offsets[-1] = log_predicted
        np.matmul(self._offsets, self._white, out=self._centres)

    def reset(self) -> None:
        """Restart: the reference is the untouched sheet."""
        self._baseline[:] = 0.0
        self._averaged = self._steps = 0
        self._noise = math.inf
        self._peak = 0.0
        self._held = 0
        self._use(self._home)

    def touched(self) -> bool:
        """Return whether the sheet is touched, by ``change`` and the frames before it."""
        self._read()
        self._average()
        size = self._judge()
        if self.logit > self.threshold:
            self._held = 0
            self._peak = max(self._peak, size)
            still = self._averaged >= FOLLOW_FRAMES
            if not (still and size < RELEASED * self._peak):
                return True
            self._follow(1.0)  # what is left of it is the sheet's from now on
        self._peak = 0.0
        self._held += 1
        if self._held >= FOLLOW_FRAMES:
            self._follow(FOLLOW_SHARE)
        return False

    def look(self) -> float:
        """Judge ``change`` by itself against the reference, with no frame before it, and return the logit."""
        self._baseline[:] = 0.0
        self._read()
        self._mean[:] = self._values
        self._averaged = FOLLOW_FRAMES
        self._judge()
        return self.logit

    def fill_map(self, out: npt.NDArray[np.float32]) -> None:
        """Fill the posterior of the place by the last frame that was judged, with the peak 1 and 0 off the sheet.

        Args:
            out: (pixels,)
        """
        self._field.fill_map(out)

    def touches(self) -> list[TaughtTouch]:
        """Return the touches of the last frame that was judged, the strongest first; empty if it is untouched."""
        return self._field.touches(self.logit, self.threshold)

    def strongest(self) -> TaughtTouch:
        """Return the likeliest place of one touch in the last frame that was judged, touched or not."""
        return self._field.strongest(self.logit)

    def _use(self, shape: int) -> None:
        self._shape, self._unlike = shape, False
        self._field = self._fields[self._home if shape == len(self._fields) else shape]
        self.threshold = self._field.threshold

    def _read(self) -> None:
        """Take the rows of a frame."""
        if self.logarithmic:
            np.maximum(self.change, np.float32(SMALLEST_RATIO - 1.0), out=self._values)
            np.log1p(self._values, out=self._values)
        else:
            np.copyto(self._values, self.change)

    def _average(self) -> None:
        """Take the frame into the mean, or begin another one where it differs by more than noise."""
        if self._averaged:
            np.subtract(self._values, self._last, out=self._rest)
            step = 0.5 * self._field.load(self._rest)
            if self._steps >= FIRST_STEPS:
                self._noise *= 1.0 + NOISE_STEP if step > self._noise else 1.0 - NOISE_STEP
            elif step > 0.0:
                self._steps += 1
                self._noise = min(self._noise, step)
        np.copyto(self._last, self._values)
        np.subtract(self._values, self._mean, out=self._rest)
        usual = self._noise * (1.0 + 1.0 / max(self._averaged, 1))
        if self._averaged == 0 or self._field.load(self._rest) > RESTART * usual:
            self._mean[:] = self._values
            self._averaged = 1
            return
        self._averaged = min(self._averaged + 1, MOST_AVERAGED)
        np.multiply(self._rest, np.float32(1.0 / self._averaged), out=self._rest)
        np.add(self._mean, self._rest, out=self._mean)

    def _judge(self) -> float:
        """Choose the shape, judge the mean in it, and return the squared length of what is left of the mean."""
        np.subtract(self._mean, self._baseline, out=self._rest)
        np.matmul(self._rest, self._white, out=self._at)
        np.subtract(self._centres, self._at, out=self._apart)
        np.einsum("ij,ij->i", self._apart, self._apart, out=self._distances)
        shape = int(self._distances.argmin())
        if self._distances[shape] < self._distances[self._shape] - NEARER:
            self._use(shape)
            self._peak = 0.0
        if self._averaged >= FOLLOW_FRAMES:  # the noise of a few frames is larger than that of a reading
            self._unlike = float(self._distances[self._shape]) > self._reach
        np.subtract(self._rest, self._offsets[self._shape], out=self._rest)
        size = self._field.load(self._rest)
        self.logit = self._field.judge(self._field.z)
        return size

    def _follow(self, share: float) -> None:
        """Let the baseline go a part of the way to the mean of untouched frames, which is in ``rest``."""
        np.multiply(self._rest, np.float32(share), out=self._rest)
        np.add(self._baseline, self._rest, out=self._baseline)
        self._held = 0


def field_of(bundle: Bundle) -> TaughtField | None:
    """Return what a bundle was taught, or None.

    Raises:
        BundleError: An array is missing, has a wrong shape, is not finite or out of range.
    """
    shapes = bundle.taught_arrays()
    return TaughtField(shapes, bundle.skin.grid, bundle.manifest.get("shapes", ())) if shapes else None


class TaughtFinder:
    """Finds touches for the list of a frame: where they may be, and how sure that is.

    The size of a touch is not known. Its axes and area are those of the region in which it lies: twice the standard
    errors to either side.

    Args:
        field: It has judged the frame.
        grid: Of the map.
    """

    def __init__(self, field: TaughtField, grid: Grid) -> None:
        self._field, self._grid = field, grid
        self.nothing = self._found([])
        """No touches."""

    def find(self, values: npt.NDArray[np.floating]) -> Found:
        """Return the touches of the frame that was judged last.

        Args:
            values: (pixels,) its map, which is not looked at.
        """
        return self._found(self._field.touches())

    def _found(self, touches: list[TaughtTouch]) -> Found:
        rows, doubts, pixels = [], [], []
        across, along = self._grid.pixel_mm
        for touch in touches:
            axes = sorted((4.0 * touch.sd_x_mm, 4.0 * touch.sd_y_mm), reverse=True)
            angle = 0.0 if touch.sd_x_mm >= touch.sd_y_mm else math.pi / 2
            rows.append((touch.x_mm, touch.y_mm, axes[0], axes[1], angle, math.pi / 4 * axes[0] * axes[1], 1.0))
            doubts.append((touch.sd_x_mm, touch.sd_y_mm, touch.amplitude, touch.log_likelihood_ratio))
            pixels.append((int(touch.y_mm / along) + 1) * (self._grid.shape[1] + 2) + int(touch.x_mm / across) + 1)
        number = np.arange(len(rows))
        weights = np.array([row[5] for row in rows]) / self._grid.pixel_mm2
        return Found(rows, np.array(pixels, dtype=np.intp), number, weights, number, self._grid.pixel_mm2, 0, doubts)
