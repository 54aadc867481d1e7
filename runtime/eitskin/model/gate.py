"""Decides whether the sheet is touched: a small network on dV that must hold at every deformation, unseen ones too.

The distance to the reference cannot decide this: bending changes dV up to nine times as much as a touch. The gate is
trained on untouched and touched sheets at many deformations; its manifest entry states the false-alarm rate on
deformations that it was not trained on. A frame that it calls untouched costs no inference. ::

    dV (104) -> [dV, log max(1 + dV, floor)] -> (x - mean) / scale -> relu(. w1 + b1) [-> relu(. w2 + b2)] -> logit
    touched: logit > threshold

With one hidden layer the last weights are w2 and b2, with two they are w3 and b3. Where these are matched filters the
second layer is written out: a frame reads a third of the weights. Everything
is written into arrays made at the start.

**Gates of matched filters**, complete and with missing rows.

With w the whitened logarithms of a frame, W^T l + b, and p the unit pattern of a touch in them ::

    first layer: (w, -w, f),  f = p^T w         touched: max f > c (mean |w| + a)

A response is (w, f), which needs half of the weights; the second layer is written out.

Without the rows m, w has these rows filled in with the expectation of the gate's own Gaussian. That projects w off the
space that the rows m span ::

    Q = 1 - W_m^T (W_m W_m^T)^-1 W_m            w' = Q w            f' = (p^T Q p)^-1/2 p^T Q w            a' = r a

So a filter's noise stays the same, and it finds a touch that shows in the other rows. The size |w'| of noise is r =
mean (diag Q)^1/2 of what it was. It is left so, and ``a`` follows: of a bend that is not in the Gaussian, most is in
few directions, and its strongest filter over its size goes as the root of their number, as r does.

**Faint presses.** A press that is too faint for one frame is a change against the same sheet's untouched frames.

The device and its bend, for which a gate must allow, are the same from one frame to the next. A gate of matched filters
is linear up to its first ReLU, with w the whitened logarithms and f what the filters make of them ::

    p = (w, f)      touched: max f > c (mean |w| + a)

so the same filters judge a change of p, in which the common part of both frames cancels. Two means are kept, of
untouched frames alone: ``recent`` of the last ``FAST_FRAMES``, ``base`` of the last ``SLOW_FRAMES`` ::

    p - recent      a press that comes on at once; a bend has hardly moved since        limit NEW_TOUCH_LEVEL c
    recent - base   one that takes seconds; the sheet may have been bent again          limit c
    p - base        one that was found: compared with frames before it, for hours       limit HELD_TOUCH_LEVEL c

While the sheet is touched, the means stay. A touch is gone when ``RELEASE_FRAMES`` frames in a row are below the
limit, or below ``MAX_RESIDUAL`` of its own strength: real sheets keep that much of a press for a while. Filters of one
sign distinguish the end of a touch that was taken for the untouched sheet from the beginning of a touch. To exclude
noise of any strength, the strongest filter must be ``NOISE`` times its average.

Bending the sheet under a faint press may lose the press; then only the single frame decides.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.model.denormals import flushed
from eitskin.model.small_products import product
from eitskin_proto.sensor.row_gaussian import precision_of
from eitskin_proto.sensor.table import N_ROWS

TWO_SIGNS: Final = -0.9
"""Cosine of two filters below which they are one touch of both signs."""

MIN_FILTER_SHARE: Final = 0.2
"""Share of a pattern's size below which a filter is not made stronger any more: its touch hardly shows."""


Number = TypeVar("Number", float, npt.NDArray[np.float32])

RIDGE: Final = 1e-13
"""Of the sum of squares, added to each: rows that depend on each other, as all of them do, may be missing together."""


@dataclass(frozen=True, slots=True)
class Filters:
    """The parts of a gate of matched filters.

    Args:
        whitened: k; a response begins with w (k,) and goes on with f.
        limit: c.
        still: a.
        one_sign: No two filters are the same touch with its sign turned.
    """

    whitened: int
    limit: float
    still: float
    one_sign: bool

    @classmethod
    def of(cls, arrays: Mapping[str, npt.NDArray[np.generic]]) -> "Filters | None":
        """Return those of a gate's arrays, or None of a gate that is made of something else.

        Args:
            arrays: As :class:`eitskin.model.gate.Gate` takes them.
        """
        if "w3" not in arrays:
            return None
        first, second, bias = (np.asarray(arrays[name], dtype=np.float64) for name in ("w1", "w2", "b2"))
        count = second.shape[1]
        twice = second.shape[0] - count
        size = twice // 2
        if size < 1 or twice % 2 or not np.array_equal(second[twice:], np.eye(count)):
            return None
        whitening, scale = first[:, :size], float(second[0, 0])
        made_so = (second[:twice] == scale).all() and (bias == bias[0]).all()
        if not (made_so and scale < 0 < -bias[0] and np.array_equal(first[:, size:twice], -whitening)):
            return None
        patterns = patterns_of(whitening, first[:, twice:])
        limit = -scale * size
        return cls(size, limit, float(-bias[0]) / limit, bool((patterns.T @ patterns).min() > TWO_SIGNS))

    def level(self, size: Number) -> Number:
        """Return c (mean |w| + a), above which a filter is a touch, of the sum of |w|."""
        return self.limit / self.whitened * size + self.limit * self.still

    def once(self, first: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the (n + 1, h) weights of responses from a first layer that also has those of -w."""
        return np.hstack([first[:, : self.whitened], first[:, 2 * self.whitened :]])

    def without(
        self, first: npt.NDArray[np.floating], rows: npt.NDArray[np.bool_]
    ) -> tuple[npt.NDArray[np.float64], "Filters", npt.NDArray[np.float64]]:
        """Return the (n + 1, h) weights for the remaining rows, the gate's parts then, and (k, h) what makes p' of w.

        Args:
            first: (n + 1, h) weights of responses to the logarithms, and the bias.
            rows: (n,) the missing ones; their weights become 0.
        """
        size = self.whitened
        whitening, bias = first[:-1, :size].astype(np.float64), first[-1, :size].astype(np.float64)
        patterns = patterns_of(whitening, first[:-1, size:].astype(np.float64))
        gone = whitening[rows]
        square = product(gone, gone.T)
        square += RIDGE * np.trace(square) * np.eye(len(gone))
        left = np.eye(size) - product(gone.T, product(precision_of(square), gone))
        shown = product(left, patterns)
        share = np.sqrt(np.maximum((patterns * shown).sum(axis=0) / (patterns**2).sum(axis=0), 0.0))
        change = np.hstack([left, shown / np.maximum(share, MIN_FILTER_SHARE)])
        weights = product(whitening, change)
        weights[rows] = 0.0  # but for rounding they are
        smaller = float(np.sqrt(np.maximum(np.diag(left), 0.0)).mean())
        return np.vstack([weights, product(bias[None], change)]), replace(self, still=smaller * self.still), change


def patterns_of(whitening: npt.NDArray[np.float64], filters: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the (k, n) patterns p in whitened logarithms of filters W p.

    Args:
        whitening: (rows, k) W.
        filters: (rows, n)
    """
    return product(precision_of(product(whitening.T, whitening)), product(whitening.T, filters))


Array = npt.NDArray[np.float32]

FAST_FRAMES: Final = 16
"""Frames: 80 ms at 200 frames/s, a twelfth of a bend that takes a second."""

SLOW_FRAMES: Final = 2000
"""Frames, as the untouched sheet's drift is followed (:mod:`eitskin.health.resting`): ten seconds at 200 frames/s."""

MIN_UNTOUCHED: Final = 8
"""Untouched frames before changes are judged."""

CHECK_FRAMES: Final = 8
"""Frames from one look at ``recent - base`` to the next."""

NEW_TOUCH_LEVEL: Final = 0.8
HELD_TOUCH_LEVEL: Final = 0.7
"""Of the limit c, which is that of any device at any bend."""

RELEASE_FRAMES: Final = 4
"""Frames."""

MAX_RESIDUAL: Final = 0.1
"""Share of a touch that may stay behind: real sheets keep 3 to 4 % of a press."""

SETTLED_LEVEL: Final = 0.4
"""Mean |w| over a, up to which the sheet has not moved from ``base``."""

NOISE: Final = 2.25
"""Noise alone exceeds this multiple of the strongest filter's average in one frame of 20,000."""

LEVEL_WEIGHT: Final = 1.0 / 256.0
"""Share of a frame in that average."""

MEAN: Final = (2 * FAST_FRAMES - 1) ** -0.5
"""Noise of ``recent`` over that of a frame."""


# Of arrays that are known to be ones, without the wrappers of their methods.
_largest, _smallest, _sum = np.maximum.reduce, np.minimum.reduce, np.add.reduce


class ChangeDetector:
    """Judges successive frames by their change; allocates nothing a frame.

    Args:
        filters: Of the gate.
        width: Of a response.
    """

    __slots__ = (
        "_base", "_change", "_filters", "_found", "_looked", "_missed", "_peak", "_recent", "_sizes", "_step",
        "_whitened", "held", "level", "seen", "strength",
    )  # fmt: skip

    def __init__(self, filters: Filters, width: int) -> None:
        self._base, self._recent, self._change, self._step = (np.zeros(width, dtype=np.float32) for _ in range(4))
        self._whitened, self._found = self._change[: filters.whitened], self._change[filters.whitened :]
        self._sizes = np.zeros(filters.whitened, dtype=np.float32)
        self.begin(filters)

    def begin(self, filters: Filters, kept: npt.NDArray[np.float64] | None = None) -> None:
        """Restart with other filters of the same size for the same touches; a touch that is held stays so if it can.

        Args:
            filters: The gate's from now on.
            kept: (k, width) what makes new responses of the w of those before; None if nothing does.
        """
        self._filters = filters
        if kept is None or not self.held:
            self.reset()
            return
        for mean in (self._base, self._recent):
            mean[:] = product(mean[None, : filters.whitened].astype(np.float64), kept)[0]
        self._peak = 0.0  # the rows that are gone may have been wild

    def reset(self) -> None:
        """Restart: the untouched sheet's voltages are not known."""
        self.seen = 0
        """Untouched frames that are remembered."""
        self.level = 0.0
        """Average of the strongest filter over untouched frames."""
        self.held = False
        """Whether the sheet is touched; the means then stay."""
        self.strength = 0.0
        """The strongest filter of the last change examined."""
        self._peak = 0.0
        self._missed = self._looked = 0

    def step(self, response: Array, touched: bool) -> bool:
        """Return whether the change of a frame shows a touch.

        Args:
            response: (width,) p.
            touched: The gate's decision on the frame alone.
        """
        if self.held:
            return self._judge_touched(response, touched)
        ratio = self._compare(response, self._recent)
        found = self.seen >= MIN_UNTOUCHED and ratio > NEW_TOUCH_LEVEL * self._filters.limit
        if not (found or touched):
            self._learn(response)
            found = self._looked == CHECK_FRAMES and self._check_recent()
            if not found:
                return False
        elif self.seen < MIN_UNTOUCHED:
            return False  # nothing to hold it against
        elif self._moved():
            np.copyto(self._base, self._recent)
        self._compare(response, self._base)
        self.held, self._missed, self._peak = True, 0, self.strength
        return found

    def _judge_touched(self, response: Array, touched: bool) -> bool:
        """Judge a frame while a touch is known."""
        there = self._compare(response, self._base) > HELD_TOUCH_LEVEL * self._filters.limit
        stays = there and self.strength > MAX_RESIDUAL * self._peak
        if stays or touched:
            self._missed = 0
            if self.strength > self._peak:
                self._peak = min(self.strength, 2.0 * self._peak or self.strength)  # one wild frame is no measure
            return stays
        self._missed += 1
        self._mix(self._recent, response, 1.0 / self._missed)
        if self._missed == RELEASE_FRAMES:
            self.held = False
            if there:
                self.reset()  # what is left of it is the sheet's from now on
        return False

    def _learn(self, response: Array) -> None:
        """Add an untouched frame to ``recent``, with which it was compared."""
        self.seen += 1
        if self.seen > 1:
            self.level += (self.strength - self.level) * max(LEVEL_WEIGHT, 1.0 / (self.seen - 1))
        self._mix(self._recent, response, max(1.0 / FAST_FRAMES, 1.0 / self.seen))
        if self.seen <= MIN_UNTOUCHED:
            np.copyto(self._base, self._recent)
        else:
            self._looked += 1

    def _check_recent(self) -> bool:
        """Hold ``recent`` against ``base``, and return whether that shows a touch; else ``base`` follows."""
        self._looked = 0
        ratio = self._compare(self._recent, self._base, MEAN, ends=True)
        if ratio > self._filters.limit:
            return True
        if -ratio > self._filters.limit:
            self.reset()  # a touch that had been taken for the untouched sheet is gone
        else:
            self._mix(self._base, self._recent, max(CHECK_FRAMES / SLOW_FRAMES, CHECK_FRAMES / self.seen))
        return False

    def _compare(self, now: Array, before: Array, noise: float = 1.0, *, ends: bool = False) -> float:
        """Return strength over size of a change, below 0 where a touch has gone; 0 where it may be noise alone.

        Args:
            now: (width,) p.
            before: (width,) p.
            noise: Of ``now``, over that of a frame.
            ends: Whether the end of a touch is looked for where none begins.
        """
        np.subtract(now, before, out=self._change)
        self.strength = strength = float(_largest(self._found))
        floor = NOISE * self.level * noise
        if strength <= floor and not ends:
            return 0.0
        against = -float(_smallest(self._found)) if self._filters.one_sign else 0.0
        if max(strength, against) <= floor:
            return 0.0
        return (strength if strength >= against else -against) / (self._size() + self._filters.still)

    def _moved(self) -> bool:
        """Return whether the sheet has moved since ``base``: then ``recent`` is nearer to the untouched sheet."""
        np.subtract(self._recent, self._base, out=self._change)
        return self._size() > SETTLED_LEVEL * self._filters.still

    def _size(self) -> float:
        """Return mean |w| of the change."""
        np.abs(self._whitened, out=self._sizes)
        return float(_sum(self._sizes)) / self._filters.whitened

    def _mix(self, mean: Array, value: Array, share: float) -> None:
        np.subtract(value, mean, out=self._step)
        np.multiply(self._step, np.float32(share), out=self._step)
        np.add(mean, self._step, out=mean)


FLOOR: Final = 1e-3
"""V / V0 is not taken for less before the logarithm, where a gate names no floor of its own."""

FIELDS: Final = ("mean", "scale", "w1", "b1", "w2", "b2", "threshold")
"""Arrays of gate.npz."""

EXTRAS: Final = ("floor", "w3", "b3")
"""Optional arrays of a gate."""


_ZERO: Final = np.zeros((), dtype=np.float32)


class Gate:
    """Judges dV: fill ``change``, then call :meth:`touched`, once a frame.

    A gate of matched filters judges successive frames, each alone and by its change; any other each frame alone.

    Args:
        arrays: mean and scale (208,), w1 (208, h), b1 (h,), threshold of one value; w2 (h,) and b2 of one value, or w2
            (h, g), b2 (g,), w3 (g,) and b3 of one value; floor of one value, if it is not ``FLOOR``.
        rows: How many rows dV has, where it is not the whole table's 104: then 2 * rows instead of 208.

    Raises:
        BundleError: An array is missing, has a wrong shape, or is not finite.
    """

    __slots__ = (
        "_all_filters", "_drop", "_first", "_found", "_hidden", "_hidden_and_one", "_inputs", "_logarithms", "_output",
        "_second", "_second_hidden", "_shift", "_sizes", "_start", "_whitened", "_whole", "change", "changes",
        "features", "filters", "logit", "response", "threshold", "usual_threshold",
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
        """The present parts of a gate of matched filters; None for any other."""
        first = first if self.filters is None else self.filters.once(first)
        self._first = _single(first)
        self._second: npt.NDArray[np.float32] | None = None
        if deep and self.filters is None:
            self._second = _single(np.vstack([values["w2"], values["b2"].reshape(1, last)]))
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
        self._hidden_and_one, self._second_hidden = (
            np.ones(hidden + 1, dtype=np.float32),
            np.zeros(last, dtype=np.float32),
        )
        self._hidden = self._hidden_and_one[:hidden]
        self.changes = None if self.filters is None else ChangeDetector(self.filters, self.response.size)
        """What is remembered; None for a gate that is not made of matched filters."""
        self.logit = 0.0
        """Of the last frame judged."""

    def touched(self) -> bool:
        """Return whether the sheet is touched, by ``change`` and the frames before it."""
        at_once = self._at_once()
        return at_once if self.changes is None else self.changes.step(self.response, at_once) or at_once

    def _at_once(self) -> bool:
        """Return whether the sheet is touched, by ``change`` alone."""
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

    def reset(self) -> None:
        """Judge the next frame by itself, because the reference or the meaning of the rows has changed."""
        if self.changes is not None and self.filters is not None:
            self.changes.begin(self.filters)

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
        first, self.filters, kept = self._whole, self._all_filters, None
        if rows.any():
            weights, self.filters, change = self._all_filters.without(self._whole, rows)
            first = flushed(weights).astype(np.float32)
            kept = change if self._first[:-1][~rows].any(axis=1).all() else None  # rows that come back tell news
        self._first[:] = first
        if self.changes is not None:
            self.changes.begin(self.filters, kept)
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


def _single(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    return np.ascontiguousarray(flushed(values), dtype=np.float32)


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
