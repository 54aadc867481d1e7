"""Places touches by a response field: how the rows answer to a press at each place of a sheet in one shape.

A matrix projects the rows' log(V / V_untouched) onto the few directions in which presses differ from noise; there the
noise of a press is the identity. A press of amplitude s at the place x then reads ::

    z = s f(x) + noise              f(x) known with variance v(x), s about 1 with the sd ``amplitude_sd``
    chi2(x) = sum w (z - s f)^2 + ((s - 1) / amplitude_sd)^2                    w = 1 / (1 + v), s the best
    log p(z | x) = -(freedom + q) / 2 log(freedom + chi2) - 1/2 log det         Student's t: an odd frame says less

The *gate* compares the mean of p(z | x) over the sheet with the probability of an untouched frame, whose covariance was
measured. The *map* is the posterior of the place. For several touches the strongest is subtracted, and the rest is
searched again.
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
"""How often each touch is placed again after another one was found."""

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


class ResponseField:
    """The field of one shape of the sheet: judge projected readings, then ask for the map or the touches.

    Args:
        arrays: Of taught.npz: project (rows, q), field and variance (pixels, q), inside (pixels,), untouched (q, q),
            amplitude_sd, freedom, threshold, spread, logarithm of one value each.
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
        self._q, self._freedom, self._spread, self._grid = q, freedom, spread, grid
        self._project, self._field = _single(project), _single(field)
        self._weight, self._tilt = _single(weight.T), _single((field * weight).T)  # (q, pixels)
        self._norm, self._prior = _single(norm), prior
        self._inside = inside != 0
        offset = 0.5 * np.log(weight).sum(axis=1) - 0.5 * np.log(norm / prior) - math.log(np.count_nonzero(inside))
        self._offset = np.where(self._inside, offset, -1e30).astype(np.float32)
        self._precision = _single(np.linalg.inv(untouched))
        self._untouched = -0.5 * float(np.log(sizes).sum())
        self.logarithmic = bool(_one(arrays, "logarithm"))
        """Whether it was taught logarithms of V / V_untouched, not changes of another unit."""
        columns = grid.shape[1]
        self._around = np.add.outer([-columns, 0, columns], [-1, 0, 1]).ravel()
        self._block = np.zeros(9, dtype=np.intp)
        self._found = np.zeros((MOST_TOUCHES, q), dtype=np.float32)
        self._logs, self._responses = np.zeros(9, dtype=np.float32), np.zeros((9, q), dtype=np.float32)
        steps = (np.arange(3 * FINE) + 0.5) / FINE - 1.5
        self._lagrange = _single(np.kron(_quadratic(steps), _quadratic(steps)))
        beyond = np.abs(steps) > 1.0
        self._most = np.where(beyond | beyond[:, None], 0.0, np.inf).ravel()
        self._fine_mm = np.stack([one.ravel() for one in np.meshgrid(steps, steps)]) * np.array(grid.pixel_mm)[:, None]
        self._places_mm = np.concatenate([grid.pixel_centres_mm().reshape(-1, 2).T, self._fine_mm], axis=1)
        self._squared_mm, self._moment = np.zeros_like(self._places_mm), np.zeros(2)
        self._p = np.zeros(pixels + len(self._lagrange))
        """Posterior of the pixels, and of the points round the peak that take the place of 3 x 3 of them."""
        self._squares, self._rest = np.zeros((2, q), np.float32)
        self.z = np.zeros(q, np.float32)
        """(q,) the frame, to be filled by :meth:`load`."""
        self._likelihood, self._amplitude, self._chi2, self._posterior = np.zeros((4, pixels), dtype=np.float32)
        self.threshold = _one(arrays, "threshold")
        """The logit above which a frame counts as touched."""

    def load(self, logarithms: npt.NDArray[np.float32]) -> float:
        """Project (rows,) into ``z``, and return its squared length."""
        np.matmul(logarithms, self._project, out=self.z)
        return float(self.z.dot(self.z))

    def judge(self, z: npt.NDArray[np.float32]) -> float:
        """Fill the likelihood of a touch at each place, and return the log of its mean over that of none.

        Args:
            z: (q,)
        """
        likelihood, chi2, amplitude, work = self._likelihood, self._chi2, self._amplitude, self._posterior
        np.multiply(z, z, out=self._squares)
        np.matmul(z, self._tilt, out=chi2)
        np.add(chi2, np.float32(self._prior), out=chi2)  # normal equations of s: chi2 = norm s
        np.divide(chi2, self._norm, out=amplitude)
        np.maximum(amplitude, np.float32(SMALLEST_AMPLITUDE), out=amplitude)
        np.multiply(chi2, np.float32(-2.0), out=chi2)
        np.multiply(self._norm, amplitude, out=work)
        np.add(chi2, work, out=chi2)
        np.multiply(chi2, amplitude, out=chi2)
        np.matmul(self._squares, self._weight, out=work)
        np.add(chi2, work, out=chi2)
        np.add(chi2, np.float32(self._prior + self._freedom), out=chi2)
        np.log(chi2, out=likelihood)
        exponent = -0.5 * (self._freedom + self._q)
        np.multiply(likelihood, np.float32(exponent), out=likelihood)
        np.add(likelihood, self._offset, out=likelihood)
        best = float(likelihood.max())
        np.subtract(likelihood, np.float32(best), out=self._posterior)
        np.maximum(self._posterior, np.float32(LOG_SMALLEST), out=self._posterior)
        np.exp(self._posterior, out=self._posterior)
        touched = best + math.log(float(np.add.reduce(self._posterior)))
        np.matmul(self._precision, z, out=self._squares)
        size = max(0.0, float(self._squares.dot(z)))
        return float(touched - exponent * math.log(self._freedom + size) - self._untouched)

    def fill_map(self, out: npt.NDArray[np.float32]) -> None:
        """Fill the posterior of the place by the last frame that was judged, with the peak 1 and 0 off the sheet.

        Args:
            out: (pixels,)
        """
        np.subtract(self._posterior, np.float32(SMALLEST_POSTERIOR), out=out)
        np.maximum(out, np.float32(0.0), out=out)

    def touches(self, logit: float, threshold: float) -> list[TaughtTouch]:
        """Return the touches of ``z``, the strongest first; empty if it is untouched.

        When a touch is added, each of them is placed again in what the others leave.

        Args:
            logit: Of ``z``, which was judged last.
            threshold: Of a touch's logit.
        """
        found: list[TaughtTouch] = []
        np.copyto(self._rest, self.z)
        while logit > threshold and len(found) < MOST_TOUCHES:
            found.append(self._subtract(len(found), logit))
            for number in [*range(len(found))] * (ROUNDS if len(found) > 1 else 0):
                np.add(self._rest, self._found[number], out=self._rest)
                found[number] = self._subtract(number, self.judge(self._rest))
            logit = self.judge(self._rest)
        if found:
            self.judge(self.z)  # the map is that of the whole frame
        return found

    def strongest(self, logit: float) -> TaughtTouch:
        """Return the likeliest place of one touch in ``z``, touched or not.

        Args:
            logit: Of ``z``, which was judged last.
        """
        np.copyto(self._rest, self.z)
        return self._subtract(0, logit)

    def _subtract(self, number: int, logit: float) -> TaughtTouch:
        """Return the likeliest touch in ``rest``, which was judged last, and subtract it there as the touch ``number``.

        Round the peak the likelihood is interpolated by a paraboloid through 3 x 3 pixels, because the posterior can
        be narrower than a pixel.
        """
        rows, columns = self._grid.shape
        peak = int(self._likelihood.argmax())
        row, column = (min(max(at, 1), n - 2) for at, n in zip(divmod(peak, columns), (rows, columns), strict=True))
        centre = row * columns + column
        np.add(self._around, centre, out=self._block)
        np.take(self._likelihood, self._block, out=self._logs)
        np.subtract(self._logs, self._likelihood[peak], out=self._logs)
        np.maximum(self._logs, np.float32(LOG_SMALLEST), out=self._logs)  # off the sheet, or as good as
        fine, pixels = self._p[-len(self._lagrange) :], self._p[: -len(self._lagrange)]
        np.matmul(self._lagrange, self._logs, out=fine)
        np.minimum(fine, self._most, out=fine)  # a parabola may run away beyond its points
        best = int(fine.argmax())
        np.exp(fine, out=fine)
        np.multiply(fine, 1.0 / FINE**2, out=fine)
        np.copyto(pixels, self._posterior)
        pixels[self._block] = 0.0
        np.add(self._fine_mm, self._places_mm[:, centre, None], out=self._places_mm[:, -len(fine) :])
        total = float(np.add.reduce(self._p))
        mean = np.matmul(self._places_mm, self._p, out=self._moment) / total
        x_mm, y_mm = (float(one) for one in mean)
        np.subtract(self._places_mm, mean[:, None], out=self._squared_mm)
        np.multiply(self._squared_mm, self._squared_mm, out=self._squared_mm)
        np.matmul(self._squared_mm, self._p, out=self._moment)
        sd_x, sd_y = (self._spread * math.sqrt(float(one) / total) for one in self._moment)
        amplitude = float(self._amplitude[peak])
        np.take(self._field, self._block, axis=0, out=self._responses)
        response = self._found[number]
        np.matmul(self._lagrange[best], self._responses, out=response)
        np.multiply(response, np.float32(amplitude), out=response)
        np.subtract(self._rest, response, out=self._rest)
        return TaughtTouch(x_mm, y_mm, sd_x, sd_y, amplitude, logit)


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
