"""Corrects the Gaussian's estimate of missing rows (:mod:`eitskin.health.imputation`), because touches act nonlinearly.

A small network, exported with the bundle's own, takes all rows as the Gaussian completed them, the missing electrodes
and V_pred, and corrects the rows of those electrodes ::

    [ l - mean | gone | log(V_pred / V0) ]  (224,) -> w -> w -> (26 to 73,)     silu(x) = x / (1 + exp(-x)) between

Weights are stored in half precision and multiplied in single: 0.7 MB that a frame with a failed electrode reads. A
healthy frame reads none of it. A bundle without the arrays has no correction; the Gaussian alone then fills in.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.model.denormals import flushed
from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS

Single = npt.NDArray[np.float32]

NAMES: Final = (
    "filling_first",
    "filling_first_bias",
    "filling_second",
    "filling_second_bias",
    "filling_third",
    "filling_third_bias",
)
"""Arrays of consistency.npz, all of them or none."""

INPUTS: Final = 2 * N_ROWS + N_ELECTRODES

_GONE: Final = slice(N_ROWS, N_ROWS + N_ELECTRODES)


@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """The correction's weights; read from a bundle."""

    first: Single
    """(224, w)"""
    first_bias: Single
    second: Single
    """(w, w)"""
    second_bias: Single
    third: Single
    """(w, 104)"""
    third_bias: Single

    @classmethod
    def of(cls, arrays: Mapping[str, npt.NDArray[np.generic]]) -> "Layers | None":
        """Return a bundle's weights, or None for a bundle without them.

        Raises:
            BundleError: Some are missing, have another shape, or are not finite.
        """
        if not any(name in arrays for name in NAMES):
            return None
        found = [np.asarray(arrays.get(name, np.zeros(0)), dtype=np.float32) for name in NAMES]
        width = found[1].size
        shapes = ((INPUTS, width), (width,), (width, width), (width,), (width, N_ROWS), (N_ROWS,))
        for name, value, shape in zip(NAMES, found, shapes, strict=True):
            if value.shape != shape or not value.size or not np.isfinite(value).all():
                raise BundleError(
                    f"consistency.npz: {name} found {value.shape}, expected {shape} finite numbers; make the bundle "
                    "again with 'eitskin export'"
                )
        return cls(*map(flushed, found))


class Correction:
    """Corrects the rows of the electrodes that are gone now; allocates nothing a frame.

    Args:
        layers: Of the bundle.
        rows: (n,) numbers of these rows.
        electrodes: The electrodes.
    """

    __slots__ = ("_first", "_first_bias", "_half", "_hidden", "_input", "_out", "_second", "_second_bias", "_third",
                 "_third_bias")  # fmt: skip

    def __init__(self, layers: Layers, rows: npt.NDArray[np.intp], electrodes: tuple[int, ...]) -> None:
        gone = np.zeros(N_ELECTRODES, dtype=np.float32)
        gone[list(electrodes)] = 1.0
        self._first = np.ascontiguousarray(np.delete(layers.first, _GONE, axis=0).T)  # (w, 208)
        self._first_bias = layers.first_bias + gone @ layers.first[_GONE]
        self._second, self._second_bias = np.ascontiguousarray(layers.second.T), layers.second_bias
        self._third, self._third_bias = np.ascontiguousarray(layers.third[:, rows].T), layers.third_bias[rows]
        self._input = np.zeros(2 * N_ROWS, dtype=np.float32)
        self._hidden, self._half = np.zeros((2, len(self._second)), dtype=np.float32), np.float32(0.5)
        self._out = np.zeros(len(rows), dtype=np.float32)

    def of(self, apart: npt.NDArray[np.float64], predicted: Single) -> Single:
        """Return (n,) what to add to l in the rows; the next call overwrites it.

        Args:
            apart: (104,) l - mean, completed by the Gaussian.
            predicted: (104,) log(V_pred / V0), zeros without a prediction.
        """
        self._input[:N_ROWS], self._input[N_ROWS:] = apart, predicted
        first, second = self._hidden
        np.matmul(self._first, self._input, out=first)
        self._activate(first, self._first_bias)
        np.matmul(self._second, first, out=second)
        self._activate(second, self._second_bias)
        np.matmul(self._third, second, out=self._out)
        np.add(self._out, self._third_bias, out=self._out)
        return self._out

    def _activate(self, values: Single, bias: Single) -> None:
        """Add the bias and apply silu in place, by its form in tanh, which overflows nowhere."""
        np.add(values, bias, out=values)
        np.multiply(values, self._half, out=values)
        values += values * np.tanh(values)
