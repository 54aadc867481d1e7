"""Finds touches by what a sheet was taught, in one shape or several: the shape, the averages and the drift.

``eitskin teach`` learns from recorded presses the *response field* (:mod:`eitskin.model.response_field`), one for each
shape in which the sheet was pressed, and the level of its untouched rows. At run time ::

    change = log(V / V_reference) = level of the shape - level of the reference + drift + touch + noise

The *shape* is the one whose level is nearest. Presses, drift and noise count as noise of that distance, so a press is
not taken for a bend. V_pred is one more candidate: with it the shape is the reference's, and the level predicted. If
touches then leave more of the still rows than of any press that was taught, the shape is unknown.

While the sheet is still, frames are averaged (:mod:`eitskin.model.stillness`), and their mean is judged. While it is
untouched, the *baseline* follows the mean, so drift does not look like a touch; it stays while the sheet is touched,
however long.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError, MismatchError
from eitskin.model.bundle import Bundle
from eitskin.model.response_field import HINT, ResponseField, TaughtTouch, finite
from eitskin.model.stillness import FEWEST, Stillness
from eitskin.touches.moments import Found
from eitskin_proto.sensor.row_table import MIN_ELECTRODES
from eitskin_proto.sensor.wiring import rank_correlation
from eitskin_proto.skin.grid import Grid

FOLLOW_FRAMES: Final = 32
"""The baseline follows after so many untouched frames, with touches between them or none."""

LEAST_STILL: Final = 8
"""It follows no sheet that was still for fewer frames."""

FOLLOW_SHARE: Final = 0.5
"""Part of the way to their mean that it goes."""

RELEASED: Final = 0.02
"""A still frame with less than this share of the touch's largest squared response is the untouched sheet again."""

LEAST_NOISE: Final = 1e-6
"""Variance of a frame, over that of taught readings: a simulation without noise has none."""

LEAST_SIZE: Final = 1e-4
"""Variance of the noise in a direction, over that in the noisiest one."""

ENOUGH: Final = 1000
"""Readings by which the taught covariance is as good as known."""

SMALLEST_RATIO: Final = 1e-6
"""V / V0 is not taken for less before the logarithm."""

LEAST_ALIKE: Final = 0.7
"""Rank correlation of the levels of a reference and of the taught sheet; rows in another order have much less."""

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
            presses, drift and noise have unit variance.
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
        blank = {"level": np.zeros(rows), "white": np.zeros((rows, 0))}
        self._levels = np.stack([finite({**blank, **one}, "level", (rows,)) for one in shapes])
        white = finite({**blank, **shapes[0]}, "white", (rows, None)).astype(np.float32)
        parts = [*(one.project for one in self._fields), white]
        ends = np.cumsum([0, *(part.shape[1] for part in parts)])
        self._parts = [slice(*ends[at : at + 2]) for at in range(len(parts))]
        """Where each shape's projection is in a projected frame, and at last the one that tells shapes apart."""
        self._project = np.ascontiguousarray(np.concatenate(parts, axis=1))
        """One matrix for all of them."""
        size = self._project.shape[1]
        self._offsets = np.zeros((len(shapes) + 1, size), np.float32)
        """Projected levels against the reference's; the last one is predicted."""
        self._centres, self._apart = self._offsets[:, self._parts[-1]], np.zeros_like(self._offsets[:, self._parts[-1]])
        self._distances = np.zeros(len(shapes) + 1, np.float32)
        self.change, self._values = np.zeros((2, rows), np.float32)
        """(rows,) dV against the reference, to be filled before :meth:`touched`."""
        self._now, self._rest, self._baseline = np.zeros((3, size), np.float32)
        self.stillness = Stillness(size)
        """Averages projected frames that differ only by noise."""
        self.is_new = True
        """Whether the last frame's mean is another one than the frame's before."""
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

    def use_reference(
        self,
        voltages_V: npt.NDArray[np.float64],
        spread_V: npt.NDArray[np.float64] | None = None,
        shared_V: npt.NDArray[np.float64] | None = None,
        frames: int = 0,
        most: int | None = None,
    ) -> None:
        """Find the shape in which the reference was taken, from which the levels of the others are counted.

        Args:
            voltages_V: (rows,), 0 where a row carries no information.
            spread_V: (rows,) standard deviation of a frame; None where only taught readings say it.
            shared_V: (rows, k) the part of it that rows share.
            frames: How many frames that is of; of fewer than 6, only taught readings say it.
            most: Frames that a mean may be of; None for as many as the runtime averages.

        Raises:
            MismatchError: Its rows have other levels than the sheet that was taught.
        """
        carries = voltages_V != 0.0
        known = carries & (self._levels != 0.0).all(axis=0)
        if known.any():
            apart = np.where(known, self._levels - np.log(np.abs(np.where(known, voltages_V, 1.0))), 0.0)
            apart -= np.where(known, np.median(apart[:, known], axis=1, keepdims=True), 0.0)  # another current
            self._home = int(((apart @ self._project[:, self._parts[-1]]) ** 2).sum(axis=1).argmin())
            alike = rank_correlation(self._levels[self._home, known], np.abs(voltages_V[known]))
            if known.sum() >= MIN_ELECTRODES and alike < LEAST_ALIKE:
                found = f"a rank correlation of {alike:.2f} with the taught sheet's voltages"
                hint = "print rows in the taught order, or teach this sheet again"
                raise MismatchError(
                    "the reference: the order of its rows", found=found, expected=LEAST_ALIKE, hint=hint
                )
        levels = np.where(known, self._levels - self._levels[self._home], 0.0)
        np.matmul(levels, self._project, out=self._offsets[:-1], casting="same_kind")
        self.use_prediction(levels[self._home])
        self._use(self._home)
        project = self._field.project * np.where(carries, 1.0 / np.where(carries, voltages_V, 1.0), 0.0)[:, None]
        taught = self._field.untouched
        if spread_V is None or frames <= FEWEST + 1:
            noise, frames = taught, ENOUGH
        else:
            shared = project.T @ (np.zeros((len(carries), 0)) if shared_V is None else shared_V)
            own = np.maximum(spread_V**2 - (0.0 if shared_V is None else (shared_V**2).sum(axis=1)), 0.0)
            noise = LEAST_NOISE * taught + (project.T * own) @ project + shared @ shared.T
        size, vectors = np.linalg.eigh(noise)
        size = np.maximum(size, LEAST_SIZE * size[-1])
        weight, less = np.zeros(len(self._now)), np.zeros((len(size), len(self._now)))
        home = self._parts[self._home]
        weight[home], less[:, home] = size[0] ** -0.5, np.sqrt(1.0 - size[0] / size)[:, None] * vectors.T
        self.stillness.use_noise(weight, less, frames, most)

    def use_prediction(self, log_predicted: npt.NDArray[np.floating]) -> None:
        """Take the level that the forward model predicts, (rows,) log(V_pred / V_reference); zeros for none."""
        np.matmul(log_predicted, self._project, out=self._offsets[-1], casting="same_kind")

    def reset(self) -> None:
        """Restart: the reference is the untouched sheet."""
        self._baseline[:] = 0.0
        self.stillness.reset()
        self._size = self._peak = 0.0
        self._rested = 0
        self._use(self._home)

    def touched(self) -> bool:
        """Return whether the sheet is touched, by ``change`` and the frames before it."""
        self._read()
        self.is_new = self.stillness.take(self._now)
        if self.is_new:
            self._judge()
        still = self.stillness.still_frames
        if self.logit > self.threshold:
            self._peak = max(self._peak, self._size)
            if still < FOLLOW_FRAMES or self._size >= RELEASED * self._peak:
                return True
            self._follow(1.0)  # what is left of it is the sheet's from now on
        self._peak = 0.0
        self._rested += 1
        if self._rested >= FOLLOW_FRAMES and still >= LEAST_STILL:
            self._follow(FOLLOW_SHARE)
        return False

    def look(self) -> float:
        """Judge ``change`` by itself against the reference, with no frame before it, and return the logit."""
        self._baseline[:] = 0.0
        self._read()
        self.stillness.keep(self._now)
        self._judge(certain=True)
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

    def left(self) -> float:
        """Return what the touches leave of the last frame that was judged, as a squared length with unit noise."""
        self._field.touches(self.logit, self.threshold)
        return self._field.left

    def strongest(self) -> TaughtTouch:
        """Return the likeliest place of one touch in the last frame that was judged, touched or not."""
        return self._field.strongest(self.logit)

    def _use(self, shape: int) -> None:
        self._shape, self._unlike = shape, False
        self._part = self._home if shape == len(self._fields) else shape
        self._field = self._fields[self._part]
        self.threshold = self._field.threshold

    def _read(self) -> None:
        """Project the rows of a frame."""
        values = self.change
        if self.logarithmic:
            values = np.maximum(values, np.float32(SMALLEST_RATIO - 1.0), out=self._values)
            np.log1p(values, out=values)
        np.matmul(values, self._project, out=self._now)

    def _judge(self, *, certain: bool = False) -> None:
        """Choose the shape, and judge the mean in it.

        Args:
            certain: A single frame may show that the shape is unknown.
        """
        rest = self._rest
        np.subtract(self.stillness.mean, self._baseline, out=rest)
        np.subtract(self._centres, rest[self._parts[-1]], out=self._apart)
        np.einsum("ij,ij->i", self._apart, self._apart, out=self._distances)
        shape = int(self._distances.argmin())
        if self._distances[shape] < self._distances[self._shape] - NEARER:
            self._use(shape)
            self._peak = 0.0
        np.subtract(rest, self._offsets[self._shape], out=rest)
        field = self._field
        np.copyto(field.z, rest[self._parts[self._part]])
        self.logit, self._size = field.judge(field.z), float(field.z.dot(field.z))
        if certain or self.stillness.still_frames >= FOLLOW_FRAMES:  # a few frames have more noise than a reading
            self._unlike = self.left() > field.most_left

    def _follow(self, share: float) -> None:
        """Let the baseline go a part of the way to the mean of untouched frames, which is in ``rest``."""
        np.multiply(self._rest, np.float32(share), out=self._rest)
        np.add(self._baseline, self._rest, out=self._baseline)
        self._rested = 0
        self._judge()


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
