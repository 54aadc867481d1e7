"""Finds the fewest touched pixels that explain a frame: l1 on the flat sheet's sensitivity, in a few steps.

``eitskin build --physics`` writes what is precomputed. Rows are logarithms, whitened by the covariance W^-1 W^-T of
untouched sheets at many bends, so that a bend is noise and needs no cloud ::

    d = W log(1 + dV)        A = W J S        x = S z, the relative change of conductivity of each pixel
    z = argmin 1/2 ||A z - d||^2 + lambda ||z||_1,    low <= z <= high,    lambda = ``PENALTY`` max |A^T d|

J is the Jacobian, and S scales the columns of A to 1. Bounds are those of an effective contrast. The minimum is
approached by ``STEPS`` steps of the alternating direction method of multipliers (Boyd et al. 2011) ::

    v = z - u                x = v + A^T (A A^T + rho 1)^-1 (d - A v)
    z = bounded, shrunk x + u                          u += x - z

Each step is two products of a matrix and a vector. A projected gradient needs hundreds of steps for the same image.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.model.denormals import flushed

STEPS: Final = 10
"""Of each frame: 0.4 ms. The correlation with the truth is best at 8 to 12 steps, since stopping early is smoother."""

PENALTY: Final = 0.03
"""Relative to the penalty that leaves nothing."""

RHO: Final = 0.01
"""Relative to the largest squared singular value of A."""

SMALLEST_RATIO: Final = 1e-3
"""V / V0 is not taken for less before the logarithm."""

HINT: Final = "make it again with 'eitskin build --physics'"

Array = npt.NDArray[np.float32]


class Logarithms:
    """log(1 + dV) of a frame.

    Args:
        change: (rows,) dV; read.
    """

    __slots__ = ("_change", "values")

    def __init__(self, change: Array) -> None:
        self._change = change
        self.values = np.zeros_like(change)
        """(rows,) of the last frame that was taken."""

    def take(self) -> None:
        """Fill ``values`` from the frame."""
        np.maximum(self._change, np.float32(SMALLEST_RATIO - 1.0), out=self.values)
        np.log1p(self.values, out=self.values)


class SparseEngine:
    """The l1 map of a frame, the largest value scaled to 1.

    Args:
        arrays: Of l1.npz: whitening (rows, rows) W, operator (rows, pixels) A, scale (pixels,) S, limit (pixels,) of
            |z|, sign: 1 for touches that raise conductance, -1 for those that lower it, 0 for both.
        change: (rows,) dV; read.
        out: (pixels,) the map.

    Raises:
        BundleError: An array is missing, has a wrong shape or is not finite.
    """

    __slots__ = (
        "_ahead", "_back", "_data", "_high", "_logs", "_low", "_map", "_operator", "_rest", "_scale", "_shrunk",
        "_signed", "_sparse", "_step", "_whitening", "name",
    )  # fmt: skip

    def __init__(self, arrays: Mapping[str, npt.NDArray[np.generic]], change: Array, out: Array) -> None:
        self.name = "l1"
        rows, pixels = len(change), len(out)
        whitening, operator = _read(arrays, "whitening", (rows, rows)), _read(arrays, "operator", (rows, pixels))
        limit = _read(arrays, "limit", (pixels,))
        sign = sign_of(arrays)
        self._signed = sign == 0.0
        self._whitening = _single(whitening if self._signed else sign * whitening)
        square = operator @ operator.T
        largest = float(np.linalg.eigvalsh(square)[-1])
        if not largest > 0.0:
            raise BundleError(f"l1.npz: operator is 0; {HINT}")
        self._step = RHO * largest
        self._operator = _single(operator)
        self._back = _single(np.linalg.solve(square + self._step * np.eye(rows), operator).T)
        self._scale, self._high = _single(_read(arrays, "scale", (pixels,))), _single(limit)
        self._low = -self._high if self._signed else np.zeros_like(self._high)
        self._logs, self._map = Logarithms(change), out
        self._data, self._rest = np.zeros((2, rows), dtype=np.float32)
        self._sparse, self._ahead, self._shrunk = np.zeros((3, pixels), dtype=np.float32)

    def infer(self) -> None:
        """Fill the map."""
        data, rest, z, v, shrunk = self._data, self._rest, self._sparse, self._ahead, self._shrunk
        u = self._map  # the map is free until the end
        self._logs.take()
        np.matmul(self._whitening, self._logs.values, out=data)
        np.matmul(data, self._operator, out=v)
        if self._signed:
            np.abs(v, out=v)
        threshold = np.float32(max(PENALTY * float(v.max()), 0.0) / self._step)
        least = -threshold if self._signed else threshold
        z.fill(0.0)
        u.fill(0.0)
        for _ in range(STEPS):
            np.subtract(z, u, out=v)
            np.matmul(self._operator, v, out=rest)
            np.subtract(data, rest, out=rest)
            np.matmul(self._back, rest, out=shrunk)
            np.add(v, shrunk, out=v)
            np.add(v, u, out=v)  # x + u
            np.maximum(v, least, out=shrunk)
            np.minimum(shrunk, threshold, out=shrunk)
            np.subtract(v, shrunk, out=z)
            np.maximum(z, self._low, out=z)
            np.minimum(z, self._high, out=z)
            np.subtract(v, z, out=u)
        np.multiply(z, self._scale, out=self._map)
        if self._signed:
            np.abs(self._map, out=self._map)
        largest = float(self._map.max())
        if largest > 0.0:
            np.divide(self._map, largest, out=self._map)


def sign_of(arrays: Mapping[str, npt.NDArray[np.generic]]) -> float:
    """Return the sign of touches' changes of conductance, 0 for both, by l1.npz.

    Raises:
        BundleError: It says nonsense.
    """
    sign = float(_read(arrays, "sign", ()))
    if sign not in (-1.0, 0.0, 1.0):
        raise BundleError(f"l1.npz: sign is {sign:g}, expected -1, 0 or 1; {HINT}")
    return sign


def _read(arrays: Mapping[str, npt.NDArray[np.generic]], name: str, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    found = arrays.get(name)
    if found is None or found.shape != shape or not np.isfinite(np.asarray(found, dtype=np.float64)).all():
        shown = "nothing" if found is None else f"{found.shape}"
        raise BundleError(f"l1.npz: {name}: found {shown}, expected {shape} finite numbers; {HINT}")
    return np.asarray(found, dtype=np.float64)


def _single(values: npt.NDArray[Any]) -> Array:
    return np.ascontiguousarray(flushed(values), dtype=np.float32)
