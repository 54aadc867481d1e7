"""Is the sheet touched at all? A small network on dV that must hold at every deformation, also at ones it never saw.

A distance to the reference cannot tell: bending changes dV up to nine times as much as a touch. The gate is trained on
untouched and touched sheets at many deformations; its manifest entry states the false-alarm rate on deformations that
it was not trained on. A frame that it calls untouched costs no inference. ::

    dV (104) -> [dV, log max(1 + dV, floor)] -> (x - mean) / scale -> relu(. w1 + b1) [-> relu(. w2 + b2)] -> logit
    touched: logit > threshold

With one hidden layer the last weights are w2 and b2, with two they are w3 and b3. Where these are matched filters
(:mod:`eitskin.model.matched_filters`) the second layer is written out: a frame reads a third of the weights. Everything
is written into arrays made at the start.
"""

from collections.abc import Mapping
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.model.changes import Changes
from eitskin.model.denormals import flushed
from eitskin.model.matched_filters import Filters
from eitskin.model.small_products import product
from eitskin_proto.sensor.table import N_ROWS

FLOOR: Final = 1e-3
"""V / V0 is not taken for less before the logarithm, where a gate names no floor of its own."""

FIELDS: Final = ("mean", "scale", "w1", "b1", "w2", "b2", "threshold")
"""Arrays of gate.npz."""

EXTRAS: Final = ("floor", "w3", "b3")
"""Arrays that a gate may have besides."""


_ZERO: Final = np.zeros((), dtype=np.float32)


class Gate:
    """Judges dV: fill ``change``, then call :meth:`touched`, once a frame.

    Args:
        arrays: mean and scale (208,), w1 (208, h), b1 (h,), threshold of one value; w2 (h,) and b2 of one value, or w2
            (h, g), b2 (g,), w3 (g,) and b3 of one value; floor of one value, if it is not ``FLOOR``.
        rows: How many rows dV has, where it is not the whole table's 104: then 2 * rows instead of 208.

    Raises:
        BundleError: An array is missing, has a wrong shape, or is not finite.
    """

    __slots__ = (
        "_all_filters", "_drop", "_first", "_found", "_hidden", "_hidden_and_one", "_inputs", "_logarithms", "_output",
        "_second", "_second_hidden", "_shift", "_sizes", "_start", "_whitened", "_whole", "change", "features",
        "filters", "logit", "response", "threshold", "usual_threshold",
    )  # fmt: skip

    def __init__(self, arrays: Mapping[str, npt.NDArray[np.generic]], rows: int = N_ROWS) -> None:
        deep = "w3" in arrays
        names = (*FIELDS, *(name for name in EXTRAS if name in arrays or (deep and name == "b3")))
        values = {name: _finite(arrays, name) for name in names}
        hidden, last = values["b1"].size, values["b2"].size
        shapes = {"mean": (2 * rows,), "scale": (2 * rows,), "w1": (2 * rows, hidden)}
        shapes |= {"w2": (hidden, last), "w3": (last,)} if deep else {"w2": (hidden,)}
        for name, shape in shapes.items():
            if values[name].shape != shape:
                raise BundleError(f"gate.npz: {name} has shape {values[name].shape}, expected {shape}; export it again")
        scale = values["scale"]
        if not (np.abs(scale) > 0).all():
            raise BundleError("gate.npz: scale holds a zero, expected every feature to vary; export it again")
        floor = float(values["floor"].reshape(-1)[0]) if "floor" in values else FLOOR
        if not 0.0 < floor < 1.0:
            raise BundleError(f"gate.npz: floor is {floor:g}, expected more than 0 and less than 1; export it again")
        self._drop = np.array(floor - 1.0, dtype=np.float32)  # a Python number would be converted in every call
        # Standardisation and bias are folded into the first layer, the bias as the weights of a feature that is 1:
        # on a paced loop every operation costs microseconds of cold cache, whatever its size.
        weights = values["w1"] / scale[:, None]
        bias = values["b1"] - values["mean"] @ weights
        # a gate that goes by logarithms alone reads half of the weights
        self._start = start = 0 if weights[:rows].any() else rows
        first = np.vstack([weights[start:], bias[None]])
        self._whole: npt.NDArray[np.float32] | None = None
        """The first layer for all rows, while another is used."""
        self._all_filters = self.filters = Filters.of(arrays) if start else None
        """What a gate of matched filters is made of now; None for any other."""
        first = first if self.filters is None else self.filters.once(first)
        self._first = np.ascontiguousarray(flushed(first), dtype=np.float32)
        self._second: npt.NDArray[np.float32] | None = None
        if deep and self.filters is None:
            layers = np.vstack([values["w2"], values["b2"].reshape(1, last)])
            self._second = np.ascontiguousarray(flushed(layers), dtype=np.float32)
        self._output = np.asarray(values["w3" if deep else "w2"], dtype=np.float32).reshape(-1)
        self._shift = float(values["b3" if deep else "b2"].reshape(-1)[0])
        self.usual_threshold = float(values["threshold"].reshape(-1)[0])
        """That of the bundle, set on frames of which no row was missing."""
        self.threshold = self.usual_threshold
        """The logit above which a frame counts as touched."""
        self.features = np.ones(2 * rows + 1, dtype=np.float32)
        self.change = self.features[:rows]
        """(104,) or (rows,) dV, to be filled before ``touched``."""
        self._logarithms = self.features[rows : 2 * rows]
        self._inputs = self.features[start:]
        self.response = np.zeros(first.shape[1], dtype=np.float32)
        """(h,) what the first layer makes of the last frame judged, before its ReLU; (w, f) of matched filters."""
        whitened = 0 if self.filters is None else self.filters.whitened
        self._whitened, self._found = np.split(self.response, [whitened])
        self._sizes = np.zeros(whitened, dtype=np.float32)
        self._hidden_and_one = np.ones(hidden + 1, dtype=np.float32)
        self._hidden = self._hidden_and_one[:hidden]
        self._second_hidden = np.zeros(last, dtype=np.float32)
        self.logit = 0.0
        """Of the last frame judged."""

    def touched(self) -> bool:
        """Return whether the sheet is touched, by ``change``."""
        np.maximum(self.change, self._drop, out=self._logarithms)
        np.log1p(self._logarithms, out=self._logarithms)
        hidden = self._hidden
        np.matmul(self._inputs, self._first, out=self.response)
        if self.filters is not None:
            hidden = self._second_hidden
            np.abs(self._whitened, out=self._sizes)
            np.subtract(self._found, self.filters.level(float(np.add.reduce(self._sizes))), out=hidden)
            np.maximum(hidden, _ZERO, out=hidden)
        else:
            np.maximum(self.response, _ZERO, out=hidden)
        if self._second is not None:
            np.matmul(self._hidden_and_one, self._second, out=self._second_hidden)
            hidden = self._second_hidden
            np.maximum(hidden, _ZERO, out=hidden)
        self.logit = float(hidden.dot(self._output)) + self._shift
        return self.logit > self.threshold

    def forget(self) -> None:
        """Judge the next frame by itself; this gate never does otherwise."""

    def leave_out(self, rows: npt.NDArray[np.bool_]) -> bool:
        """Judge without some rows from the next frame on, and return whether this gate can: one of matched filters.

        Args:
            rows: (104,) or (rows,) the missing ones; none brings all back.
        """
        if self._all_filters is None:
            return False
        if self._whole is None:
            if not rows.any():
                return True
            self._whole = self._first.copy()
        first, self.filters = self._whole, self._all_filters
        if rows.any():
            weights, self.filters = self._all_filters.without(self._whole, rows)
            first = flushed(weights).astype(np.float32)
        self._first[:] = first
        return True

    def logits(self, changes: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """Return (n,) logits of (n, 104) dV, the last frame's untouched: for a look at many frames at once."""
        small = np.asarray(changes, dtype=np.float32)
        features = np.concatenate(
            [small, np.log1p(np.maximum(small, self._drop)), np.ones((len(small), 1), dtype=np.float32)], axis=1
        )
        hidden = product(features[:, self._start :], self._first)
        if self.filters is not None:
            sizes = np.abs(hidden[:, : self.filters.whitened]).sum(axis=1, keepdims=True)
            hidden = hidden[:, self.filters.whitened :] - self.filters.level(sizes)
        hidden = np.maximum(hidden, _ZERO)
        if self._second is not None:
            hidden = np.maximum(product(hidden, self._second[:-1]) + self._second[-1], _ZERO)
        return np.asarray(hidden @ self._output + np.float32(self._shift), dtype=np.float32)


class RememberingGate(Gate):
    """Judges frames that come one after the other, each by itself and by what has changed (``eitskin.model.changes``).

    A gate that is not made of matched filters judges each frame by itself alone.

    Args:
        arrays: As of :class:`Gate`.
        rows: As of :class:`Gate`.

    Raises:
        BundleError: As :class:`Gate` does.
    """

    __slots__ = ("changes",)

    def __init__(self, arrays: Mapping[str, npt.NDArray[np.generic]], rows: int = N_ROWS) -> None:
        super().__init__(arrays, rows)
        self.changes = None if self.filters is None else Changes(self.filters, self.response.size)

    def touched(self) -> bool:
        """Return whether the sheet is touched, by ``change`` and the frames before it."""
        at_once = super().touched()
        return at_once if self.changes is None else self.changes.step(self.response, at_once) or at_once

    def forget(self) -> None:
        """Begin anew: the reference, or what the rows mean, is another one."""
        if self.changes is not None and self.filters is not None:
            self.changes.begin(self.filters)


class Forgets(Protocol):
    """Something that judges by what it remembers."""

    def forget(self) -> None:
        """Judge the next frame by itself."""


def begin_anew(*judges: Forgets | None) -> None:
    """Let all that there are forget the frames before: the reference, or the device, is another one."""
    for judge in judges:
        if judge is not None:
            judge.forget()


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
