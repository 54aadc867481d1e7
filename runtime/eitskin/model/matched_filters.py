"""Gates of matched filters: what they are made of, and what is left of them where rows are missing.

With w the whitened logarithms of a frame, W^T l + b, and p the unit pattern of a touch in them ::

    first layer: (w, -w, f),  f = p^T w         touched: max f > c (mean |w| + a)

A response is (w, f): that is half of the weights, and what the layer behind them makes of it is written out.

What a frame says without the rows m is w with the rows filled in as the gate's own Gaussian expects them. That is a
projection of w, off the space that the rows m span ::

    Q = 1 - W_m^T (W_m W_m^T)^-1 W_m            w' = Q w            f' = (p^T Q p)^-1/2 p^T Q w            a' = r a

So a filter's noise is what it was, and a touch that shows in the other rows is found by them. The size |w'| of noise
is r = mean (diag Q)^1/2 of what it was. It is left so, and ``a`` follows: of a bend that is not in the Gaussian, most
is in few directions, and its strongest filter over its size goes as the root of their number, as r does.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from eitskin.model.small_products import product
from eitskin_proto.sensor.row_gaussian import precision_of

TWO_SIGNS: Final = -0.9
"""Cosine of two filters below which they are one touch of both signs."""

LEFT_OF_IT: Final = 0.2
"""Share of a pattern's size below which a filter is not made stronger any more: its touch hardly shows."""


Number = TypeVar("Number", float, npt.NDArray[np.float32])

RIDGE: Final = 1e-13
"""Of the sum of squares, added to each: rows that depend on each other, as all of them do, may be missing together."""


@dataclass(frozen=True, slots=True)
class Filters:
    """What a gate of matched filters is made of.

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
        """Return the (n + 1, h) weights of responses, of a first layer that has those of -w besides."""
        return np.hstack([first[:, : self.whitened], first[:, 2 * self.whitened :]])

    def without(
        self, first: npt.NDArray[np.floating], rows: npt.NDArray[np.bool_]
    ) -> tuple[npt.NDArray[np.float64], "Filters"]:
        """Return the (n + 1, h) weights that judge by the rows that are left, and what the gate is made of then.

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
        change = np.hstack([left, shown / np.maximum(share, LEFT_OF_IT)])
        weights = product(whitening, change)
        weights[rows] = 0.0  # but for rounding they are
        smaller = float(np.sqrt(np.maximum(np.diag(left), 0.0)).mean())
        return np.vstack([weights, product(bias[None], change)]), replace(self, still=smaller * self.still)


def patterns_of(whitening: npt.NDArray[np.float64], filters: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the (k, n) patterns p in whitened logarithms of filters W p.

    Args:
        whitening: (rows, k) W.
        filters: (rows, n)
    """
    return product(precision_of(product(whitening.T, whitening)), product(whitening.T, filters))
