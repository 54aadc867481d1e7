"""Is the sheet touched at all? A small network on dV that must hold at every deformation, also at ones it never saw.

A distance to the reference cannot tell: bending changes dV up to nine times as much as a touch. The gate is trained on
untouched and touched sheets at many deformations; its manifest entry states the false-alarm rate on deformations that
it was not trained on. A frame that it calls untouched costs no inference. ::

    dV (104) -> [dV, log max(1 + dV, 1e-3)] -> (x - mean) / scale -> relu(. w1 + b1) -> . w2 + b2 > threshold

Everything is written into arrays made at the start.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin_proto.table import N_ROWS

LOG_FLOOR: Final = 1e-3
"""1 + dV is cut off here before the logarithm; V/V0 reaches 5e-4 on a healthy sheet."""

FIELDS: Final = ("mean", "scale", "w1", "b1", "w2", "b2", "threshold")
"""Arrays of gate.npz."""


class Gate:
    """Judges dV; call :meth:`touched` a frame.

    Args:
        arrays: mean and scale (208,), w1 (208, hidden), b1 (hidden,), w2 (hidden,), b2 and threshold of one value.

    Raises:
        BundleError: An array is missing, has a wrong shape, or is not finite.
    """

    __slots__ = ("_bias", "_features", "_hidden", "_logarithms", "_output", "_shift", "_weights", "logit", "threshold")

    def __init__(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        values = {name: _finite(arrays, name) for name in FIELDS}
        hidden = values["b1"].size
        shapes = {"mean": (2 * N_ROWS,), "scale": (2 * N_ROWS,), "w1": (2 * N_ROWS, hidden), "w2": (hidden,)}
        for name, shape in shapes.items():
            if values[name].shape != shape:
                raise BundleError(f"gate.npz: {name} has shape {values[name].shape}, expected {shape}; export it again")
        scale = values["scale"]
        if not (np.abs(scale) > 0).all():
            raise BundleError("gate.npz: scale holds a zero, expected every feature to vary; export it again")
        # The standardisation is folded into the first layer: two fewer operations a frame.
        weights = values["w1"] / scale[:, None]
        self._weights = np.ascontiguousarray(weights, dtype=np.float32)
        self._bias = np.asarray(values["b1"] - values["mean"] @ weights, dtype=np.float32)
        self._output = np.asarray(values["w2"], dtype=np.float32)
        self._shift = float(values["b2"].reshape(-1)[0])
        self.threshold = float(values["threshold"].reshape(-1)[0])
        """The logit above which a frame counts as touched."""
        self._features = np.zeros(2 * N_ROWS, dtype=np.float32)
        self._logarithms = self._features[N_ROWS:]
        self._hidden = np.zeros(hidden, dtype=np.float32)
        self.logit = 0.0
        """Of the last frame judged."""

    def touched(self, change: npt.NDArray[np.float32]) -> bool:
        """Return whether the sheet is touched.

        Args:
            change: (104,) dV.
        """
        logarithms = self._logarithms
        self._features[:N_ROWS] = change
        np.add(change, 1.0, out=logarithms)
        np.maximum(logarithms, LOG_FLOOR, out=logarithms)
        np.log(logarithms, out=logarithms)
        np.matmul(self._features, self._weights, out=self._hidden)
        np.add(self._hidden, self._bias, out=self._hidden)
        np.maximum(self._hidden, 0.0, out=self._hidden)
        self.logit = float(np.dot(self._hidden, self._output)) + self._shift
        return self.logit > self.threshold


def _finite(arrays: Mapping[str, npt.NDArray[np.generic]], name: str) -> npt.NDArray[np.float64]:
    if name not in arrays:
        raise BundleError(f"gate.npz has no array {name!r}; expected {', '.join(FIELDS)}; export it again")
    try:
        values = np.asarray(arrays[name], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BundleError(f"gate.npz: {name} is not made of numbers; export it again") from error
    if values.size == 0 or not np.isfinite(values).all():
        raise BundleError(f"gate.npz: {name} is empty or not finite; export it again")
    return values
