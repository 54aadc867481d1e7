"""Places touches by a response field: how the rows answer to a press at each place of a sheet in one shape.

A matrix projects the rows' log(V / V_untouched) onto the few directions in which presses differ from noise; there the
noise of a press is the identity. A press of amplitude s at the place x then reads ::

    z = s f(x) + noise              f(x) known with variance v(x), s about 1 with the sd ``amplitude_sd``
    chi2(x) = sum w (z - s f)^2 + ((s - 1) / amplitude_sd)^2                    w = 1 / (1 + v), s the best
    log p(z | x) = -(freedom + q) / 2 log(freedom + chi2) - 1/2 log det         Student's t: an odd frame says less

All factors that depend on the place alone are part of two matrices, one for z and one for its squares. The *gate*
compares the mean of p(z | x) over the sheet with the probability of an untouched frame, whose covariance was measured.
The *map* is the posterior of the place. For several touches the strongest is subtracted, and the rest is searched
again.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.model.denormals import flushed
from eitskin_proto.skin.grid import Grid

MOST_DIRECTIONS: Final = 64
"""q, the columns of the projection."""

SMALLEST_AMPLITUDE: Final = 0.1
"""Of a touch, where 1 is the usual one."""

MOST_TOUCHES: Final = 8
"""Touches that are searched for in a frame."""

ROUNDS: Final = 3
"""How often each touch is placed again after another one was found, at most: until no touch moves."""

OFF_SHEET: Final = 1e18
"""Of chi2 off the sheet."""

FINE: Final = 5
"""Points along each axis of a pixel, between which the likelihood is interpolated round its peak."""

SMALLEST_POSTERIOR: Final = 1e-6
"""Of its peak; less is 0 in the map."""

LOG_SMALLEST: Final = -60.0
"""Likelihoods are cut off here below their peak, where float32 is still exact."""

LARGEST: Final = 1e12
"""No array of taught.npz has a larger value."""

HINT: Final = "teach it again with 'eitskin teach'"


@dataclass(frozen=True, slots=True)
class TaughtTouch:
    """A touch of a frame."""

    x_mm: float
    y_mm: float
    """Mean of the posterior of its place, from the sheet's corner."""
    sd_x_mm: float
    sd_y_mm: float
    """Its standard deviations."""
    amplitude: float
    """Its strength; 1 is the mean of the presses that were taught."""
    log_likelihood_ratio: float
    """Logarithm of its likelihood over that of no further touch."""


class Judged:
    """Where a touch may be by what was judged last.

    Args:
        pixels: Of the map.
    """

    __slots__ = ("likelihood", "posterior", "strength")

    def __init__(self, pixels: int) -> None:
        self.likelihood, self.strength, self.posterior = np.zeros((3, pixels), np.float32)
        """Logarithm over its peak, cut off; the strength of a touch there; the posterior over its peak."""


class Peak:
    """Places the peak of a likelihood, between pixels.

    Round the peak the likelihood is interpolated by a paraboloid through 3 x 3 pixels, because the posterior can be
    narrower than a pixel.

    Args:
        grid: Of the map.
    """

    def __init__(self, grid: Grid) -> None:
        self._shape = grid.shape
        self.pixel = 0
        """The likeliest one."""
        self.block = np.zeros(9, dtype=np.intp)
        """The pixels round it."""
        self._around = np.add.outer([-grid.shape[1], 0, grid.shape[1]], [-1, 0, 1]).ravel()
        self._logs = np.zeros(9, dtype=np.float32)
        steps = (np.arange(3 * FINE) + 0.5) / FINE - 1.5
        self._lagrange = _single(np.kron(_quadratic(steps), _quadratic(steps)))
        self.weights = self._lagrange[0]
        """(9,) of the block, for values at the peak."""
        beyond = np.abs(steps) > 1.0
        self._most = np.where(beyond | beyond[:, None], 0.0, np.inf).ravel()
        self._fine = np.zeros(len(self._lagrange))
        """Posterior of points that take the place of the block."""
        fine_mm = np.stack([one.ravel() for one in np.meshgrid(steps, steps)], axis=1) * grid.pixel_mm
        self._fine_powers = _powers(fine_mm) / FINE**2
        self._centres_mm = grid.pixel_centres_mm().reshape(-1, 2)
        self._powers = _powers(self._centres_mm)
        self._p, self._moments = np.zeros(grid.n_pixels), np.zeros(5)

    def find(self, judged: Judged) -> tuple[float, float, float, float]:
        """Return x and y of the posterior's mean, and its standard deviations along both, in mm.

        Args:
            judged: Its posterior.
        """
        columns = self._shape[1]
        self.pixel = int(judged.likelihood.argmax())
        row, column = (min(max(at, 1), n - 2) for at, n in zip(divmod(self.pixel, columns), self._shape, strict=True))
        centre = row * columns + column
        np.add(self._around, centre, out=self.block)
        np.take(judged.likelihood, self.block, out=self._logs)
        fine = np.matmul(self._lagrange, self._logs, out=self._fine)
        np.minimum(fine, self._most, out=fine)  # a parabola may run away beyond its points
        self.weights = self._lagrange[int(fine.argmax())]
        np.exp(fine, out=fine)
        np.copyto(self._p, judged.posterior)
        self._p[self.block] = 0.0
        x0, y0 = self._centres_mm[centre].tolist()
        p, x, y, xx, yy = np.matmul(self._p, self._powers, out=self._moments).tolist()
        far = p, x - p * x0, y - p * y0, xx - x0 * (2.0 * x - p * x0), yy - y0 * (2.0 * y - p * y0)  # about the centre
        near = np.matmul(fine, self._fine_powers, out=self._moments).tolist()
        p, x, y, xx, yy = (one + other for one, other in zip(far, near, strict=True))
        x, y = x / p, y / p
        return x0 + x, y0 + y, math.sqrt(max(0.0, xx / p - x * x)), math.sqrt(max(0.0, yy / p - y * y))


class ResponseField:
    """The field of one shape of the sheet: judge projected readings, then ask for the map or the touches.

    Args:
        arrays: Of taught.npz: project (rows, q), field and variance (pixels, q), inside (pixels,), untouched (q, q),
            amplitude_sd, freedom, threshold, spread, logarithm of one value each; most_left too, if it is known.
        grid: Of the skin's map.

    Raises:
        BundleError: An array is missing, has a wrong shape, is not finite or out of range.
    """

    def __init__(self, arrays: Mapping[str, npt.NDArray[np.generic]], grid: Grid) -> None:
        project = finite(arrays, "project", (None, None))
        self.rows, q = project.shape
        """n, of a frame."""
        if not 1 <= q <= MOST_DIRECTIONS:
            raise BundleError(f"taught.npz: project has {q} columns, expected 1 to {MOST_DIRECTIONS}; {HINT}")
        pixels = grid.n_pixels
        field, variance = (finite(arrays, name, (pixels, q)) for name in ("field", "variance"))
        inside, untouched = finite(arrays, "inside", (pixels,)), finite(arrays, "untouched", (q, q))
        sd, freedom, spread = (_positive(arrays, name) for name in ("amplitude_sd", "freedom", "spread"))
        if variance.min() < 0.0 or not inside.any():
            raise BundleError(f"taught.npz: variance is negative, or no pixel is inside; {HINT}")
        sizes = np.linalg.eigvalsh(untouched)
        if sizes[0] <= 0.0:
            raise BundleError(f"taught.npz: untouched is no covariance; {HINT}")
        weight, prior = 1.0 / (1.0 + variance), sd**-2
        norm = (field * field * weight).sum(axis=1) + prior
        self._q, self._spread, self._grid = q, spread, grid
        self.project, self._field = _single(project), _single(field)
        """(rows, q)"""
        self.untouched = untouched
        """(q, q) covariance of an untouched reading, as it was taught."""
        self._freedom, self._exponent = freedom, -0.5 * (freedom + q)
        self._inside = inside != 0
        log_factor = 0.5 * np.log(weight).sum(axis=1) - 0.5 * np.log(norm / prior) - math.log(self._inside.sum())
        factor = np.where(self._inside, np.exp(log_factor / self._exponent), 0.0)  # of chi2
        root = np.sqrt(factor / norm)
        self._tilt = _single(root * np.vstack([(field * weight).T, np.full(pixels, prior)]))  # (q + 1, pixels)
        self._weight = _single(factor * np.vstack([weight.T, np.full(pixels, prior + freedom)]))
        self._weight[-1, ~self._inside] = OFF_SHEET
        self._least = _single(SMALLEST_AMPLITUDE * root * norm)
        self._strength = np.where(self._inside, root * norm, 1.0)
        """(pixels,) of a touch of amplitude 1, in the unit of ``_tilt``."""
        self._precision = _single(np.linalg.inv(untouched))
        self._untouched = -0.5 * float(np.log(sizes).sum())
        self.logarithmic = bool(_one(arrays, "logarithm"))
        """Whether it was taught logarithms of V / V_untouched, not changes of another unit."""
        self._peaks = np.zeros(MOST_TOUCHES, dtype=np.intp)
        self._found = np.zeros((MOST_TOUCHES, q), dtype=np.float32)
        self._responses = np.zeros((9, q), dtype=np.float32)
        self._peak = Peak(grid)
        self._one, self._squares = np.ones((2, q + 1), np.float32)
        self._white, self._rest, self.z = np.zeros((3, q), np.float32)
        """(q,) of the frame, projected; z is to be filled before :meth:`judge`."""
        self._whole, self._left = Judged(pixels), Judged(pixels)
        self.threshold = _one(arrays, "threshold")
        """The logit above which a frame counts as touched."""
        self.most_left = _one({"most_left": np.array(LARGEST), **arrays}, "most_left")
        """Largest :attr:`left` of a frame of this shape."""

    def judge(self, z: npt.NDArray[np.float32]) -> float:
        """Fill the likelihood of a touch at each place, and return the log of its mean over that of none.

        Args:
            z: (q,)
        """
        return self._judge(z, self._whole)

    def _judge(self, z: npt.NDArray[np.float32], into: Judged) -> float:
        likelihood, strength, posterior = into.likelihood, into.strength, into.posterior
        self._one[:-1] = z
        np.multiply(self._one, self._one, out=self._squares)
        np.matmul(self._one, self._tilt, out=posterior)  # normal equations of the strength
        np.matmul(self._squares, self._weight, out=likelihood)
        np.maximum(posterior, self._least, out=strength)
        np.add(posterior, posterior, out=posterior)
        np.subtract(posterior, strength, out=posterior)
        np.multiply(posterior, strength, out=posterior)
        np.subtract(likelihood, posterior, out=likelihood)  # chi2
        np.log(likelihood, out=likelihood)
        np.multiply(likelihood, np.float32(self._exponent), out=likelihood)
        best = likelihood.max()
        np.subtract(likelihood, best, out=likelihood)
        np.maximum(likelihood, np.float32(LOG_SMALLEST), out=likelihood)
        np.exp(likelihood, out=posterior)
        touched = float(best) + math.log(float(np.add.reduce(posterior)))
        np.matmul(self._precision, z, out=self._white)
        size = max(0.0, float(self._white.dot(z)))
        return float(touched - self._exponent * math.log(self._freedom + size) - self._untouched)

    def fill_map(self, out: npt.NDArray[np.float32]) -> None:
        """Fill the posterior of the place by the last frame that was judged, with the peak 1 and 0 off the sheet.

        Args:
            out: (pixels,)
        """
        np.subtract(self._whole.posterior, np.float32(SMALLEST_POSTERIOR), out=out)
        np.maximum(out, np.float32(0.0), out=out)

    def touches(self, logit: float, threshold: float) -> list[TaughtTouch]:
        """Return the touches of ``z``, the strongest first; empty if it is untouched.

        When a touch is added, each of them is placed again in what the others leave. It is not added if one of them is
        not needed then, or if two are at one place, since a hard press looks like two.

        Args:
            logit: Of ``z``, which was judged last.
            threshold: Of the strongest one's logit.
        """
        found: list[TaughtTouch] = []
        np.copyto(self._rest, self.z)
        judged = self._whole
        while logit > threshold and len(found) < MOST_TOUCHES:
            more = [*found, self._subtract(len(found), logit, judged)]
            judged = self._left
            for _ in range(ROUNDS if found else 0):
                before = self._peaks[: len(more)].tolist()
                for number in range(len(more)):
                    np.add(self._rest, self._found[number], out=self._rest)
                    more[number] = self._subtract(number, self._judge(self._rest, judged), judged)
                if self._peaks[: len(more)].tolist() == before:
                    break
            if min(one.log_likelihood_ratio for one in more) <= threshold or (found and self._at_one_place(len(more))):
                break
            found, logit, threshold = more, self._judge(self._rest, judged), max(threshold, 0.0)
        return found

    def strongest(self, logit: float) -> TaughtTouch:
        """Return the likeliest place of one touch in ``z``, touched or not.

        Args:
            logit: Of ``z``, which was judged last.
        """
        np.copyto(self._rest, self.z)
        return self._subtract(0, logit, self._whole)

    @property
    def left(self) -> float:
        """Squared length of what :meth:`touches` left of the frame."""
        return float(self._rest.dot(self._rest))

    def _at_one_place(self, count: int) -> bool:
        """Return whether some of the touches are within a pixel of another one."""
        pixels = np.stack(np.divmod(self._peaks[:count], self._grid.shape[1]))
        near = (np.abs(pixels[:, :, None] - pixels[:, None]) <= 1).all(axis=0)
        return int(near.sum()) > count

    def _subtract(self, number: int, logit: float, judged: Judged) -> TaughtTouch:
        """Return the likeliest touch in ``rest``, which was judged, and subtract it there as the touch ``number``."""
        x_mm, y_mm, sd_x_mm, sd_y_mm = self._peak.find(judged)
        pixel = self._peaks[number] = self._peak.pixel
        amplitude = float(judged.strength[pixel] / self._strength[pixel])
        np.take(self._field, self._peak.block, axis=0, out=self._responses)
        response = self._found[number]
        np.matmul(self._peak.weights, self._responses, out=response)
        np.multiply(response, np.float32(amplitude), out=response)
        np.subtract(self._rest, response, out=self._rest)
        return TaughtTouch(x_mm, y_mm, self._spread * sd_x_mm, self._spread * sd_y_mm, amplitude, logit)


def _powers(places_mm: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return (n, 5) 1, x, y and their squares, which turn a posterior into its moments."""
    return np.concatenate([np.ones((len(places_mm), 1)), places_mm, places_mm**2], axis=1)


def _quadratic(steps: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return (n, 3) weights of the values at -1, 0 and 1 in the parabola through them, at some places."""
    return np.stack([steps * (steps - 1.0) / 2.0, 1.0 - steps**2, steps * (steps + 1.0) / 2.0], axis=1)


def finite(
    arrays: Mapping[str, npt.NDArray[np.generic]], name: str, shape: tuple[int | None, ...]
) -> npt.NDArray[np.float64]:
    """Return an array of taught.npz; None in its shape stands for any number.

    Raises:
        BundleError: It is missing, has another shape, or is not finite.
    """
    if name not in arrays:
        raise BundleError(f"taught.npz has no array {name!r}; {HINT}")
    found = arrays[name]
    fits = len(found.shape) == len(shape) and all(
        want in (None, have) for have, want in zip(found.shape, shape, strict=True)
    )
    if not fits or found.dtype.kind not in "fiub":
        raise BundleError(f"taught.npz: {name} is {found.dtype} of shape {found.shape}, expected {shape}; {HINT}")
    values = np.asarray(found, dtype=np.float64)
    if not np.isfinite(values).all() or np.abs(values).max(initial=0.0) > LARGEST:
        raise BundleError(f"taught.npz: {name} has values that are not finite or above {LARGEST:g}; {HINT}")
    return values


def _one(arrays: Mapping[str, npt.NDArray[np.generic]], name: str) -> float:
    return float(finite(arrays, name, ()))


def _positive(arrays: Mapping[str, npt.NDArray[np.generic]], name: str) -> float:
    found = _one(arrays, name)
    if found <= 0.0:
        raise BundleError(f"taught.npz: {name} is {found:g}, expected more than 0; {HINT}")
    return found


def _single(values: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
    return np.ascontiguousarray(flushed(np.asarray(values, dtype=np.float64)), dtype=np.float32)
