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

LARGEST_DROP: Final = -0.999
"""dV is cut off here before log(1 + dV), as in training; V/V0 reaches 5e-4 on a healthy sheet."""

FIELDS: Final = ("mean", "scale", "w1", "b1", "w2", "b2", "threshold")
"""Arrays of gate.npz."""


class Gate:
    """Judges dV: fill ``change``, then call :meth:`touched`, once a frame.

    Args:
        arrays: mean and scale (208,), w1 (208, hidden), b1 (hidden,), w2 (hidden,), b2 and threshold of one value.
        rows: How many rows dV has, where it is not the whole table's 104: then 2 * rows instead of 208.

    Raises:
        BundleError: An array is missing, has a wrong shape, or is not finite.
    """

    __slots__ = ("_hidden", "_logarithms", "_output", "_shift", "_weights", "change", "features", "logit", "threshold")

    def __init__(self, arrays: Mapping[str, npt.NDArray[np.generic]], rows: int = N_ROWS) -> None:
        values = {name: _finite(arrays, name) for name in FIELDS}
        hidden = values["b1"].size
        shapes = {"mean": (2 * rows,), "scale": (2 * rows,), "w1": (2 * rows, hidden), "w2": (hidden,)}
        for name, shape in shapes.items():
            if values[name].shape != shape:
                raise BundleError(f"gate.npz: {name} has shape {values[name].shape}, expected {shape}; export it again")
        scale = values["scale"]
        if not (np.abs(scale) > 0).all():
            raise BundleError("gate.npz: scale holds a zero, expected every feature to vary; export it again")
        # Standardisation and bias are folded into the first layer, the bias as the weights of a feature that is 1:
        # on a paced loop every operation costs microseconds of cold cache, whatever its size.
        weights = values["w1"] / scale[:, None]
        bias = values["b1"] - values["mean"] @ weights
        self._weights = np.ascontiguousarray(np.vstack([weights, bias[None]]), dtype=np.float32)
        self._output = np.asarray(values["w2"], dtype=np.float32).reshape(hidden)
        self._shift = float(values["b2"].reshape(-1)[0])
        self.threshold = float(values["threshold"].reshape(-1)[0])
        """The logit above which a frame counts as touched."""
        self.features = np.ones(2 * rows + 1, dtype=np.float32)
        self.change = self.features[:rows]
        """(104,) or (rows,) dV, to be filled before ``touched``."""
        self._logarithms = self.features[rows : 2 * rows]
        self._hidden = np.zeros(hidden, dtype=np.float32)
        self.logit = 0.0
        """Of the last frame judged."""

    def touched(self) -> bool:
        """Return whether the sheet is touched, by ``change``."""
        np.maximum(self.change, LARGEST_DROP, out=self._logarithms)
        np.log1p(self._logarithms, out=self._logarithms)
        np.matmul(self.features, self._weights, out=self._hidden)
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
