"""The gate in closed form: matched filters, relative to the rest of a frame.

Untouched moments of random devices fill their directions by very different amounts: a stretched reference, or a bent
sheet with a gauge factor, moves all of them far, and most moments hardly any. With w the whitened logarithms, without
the factor common to all rows, such a law is one Gaussian of unknown scale. The likelihood ratio of a press of pattern s
and unknown strength is then a matched filter over that scale, here its mean absolute value ::

    f_j = s_j . w / |s_j|        touched: max over j of f_j > c (mean |w| + a)

c is set at a false-alarm rate, a excludes the noise of frames that show nothing. It is written as a network: the
first layer has w, -w and the filters, the second f_j - c (mean |w| + a), and what is left above 0 is added up. A bound
on w alone, learned or not, is determined by the few extreme moments, and the others' presses are below it.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.arrays import Array

Arrays = dict[str, npt.NDArray[np.generic]]

FILTERS: Final = 128
"""Patterns of touches. Twice as many find a few in a hundred more, and cost twice as much a frame."""

PATTERNS: Final = 3200
"""Touches that they are made of, half of them small ones, half a data set's."""

K_MEANS_ROUNDS: Final = 6
"""Of k-means."""

RESPONSE_OFFSET: Final = 0.25
"""a: as much of mean |w|, which is about 0.8 of a usual moment."""

MIN_RATIO: Final = 0.05
"""V / V0 is not taken for less before the logarithm: a row that noise drowns says nothing by its logarithm."""

MIN_TOUCH_MEAN_LOG: Final = 1e-3
"""A touch of smaller mean |log(V touched / V untouched)| has no pattern to speak of."""


def seen(touches: Array) -> Array:
    """Return those of (t, r) touches that have a pattern to speak of."""
    return np.asarray(touches[np.abs(touches).mean(axis=1) > MIN_TOUCH_MEAN_LOG])


def patterns(touches: Array, small: int, rng: np.random.Generator) -> Array:
    """Return up to ``PATTERNS`` of (t, r) touches, as many of the last ``small`` of them as of those before."""
    parts = [seen(touches[: len(touches) - small]), seen(touches[len(touches) - small :])]
    each = PATTERNS // max(sum(len(part) > 0 for part in parts), 1)
    return np.concatenate([part[rng.permutation(len(part))[:each]] for part in parts])


def bank(whitened: Array, rng: np.random.Generator) -> Array:
    """Return up to ``FILTERS`` unit vectors, the middles of (t, k) whitened patterns that point alike."""
    shown = _unit(whitened)
    found = shown[rng.permutation(len(shown))[:FILTERS]]
    for _ in range(K_MEANS_ROUNDS):
        nearest = (shown @ found.T).argmax(axis=1)
        sums = np.zeros_like(found)
        np.add.at(sums, nearest, shown)
        found = _unit(sums[np.linalg.norm(sums, axis=1) > 1e-6])
    return found


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def ratios(whitened: Array, filters: Array) -> Array:
    """Return (n,) the largest of (f, k) filters' outputs over mean |w| + a, of (n, k) whitened logarithms."""
    return np.asarray((whitened @ filters.T).max(axis=1) / (np.abs(whitened).mean(axis=1) + RESPONSE_OFFSET))


def layers(whitening: Array, filters: Array, limit: float) -> tuple[Array, Array, Array]:
    """Return two layers' weights, and the second one's biases: what it passes on is above 0 where a touch is found.

    Args:
        whitening: (r, k) that gives logarithms of untouched sheets unit covariance.
        filters: (f, k).
        limit: c.
    """
    count = whitening.shape[1]
    first = np.concatenate([whitening, -whitening, whitening @ filters.T], axis=1)
    second = np.concatenate([np.full((2 * count, len(filters)), -limit / count), np.eye(len(filters))])
    return first, second, np.full(len(filters), -limit * RESPONSE_OFFSET)


def in_form(mean: Array, w1: Array, b1: Array, w2: Array, b2: Array, w3: Array, b3: float) -> Arrays:
    """Return the arrays of a network on logarithms, (r, h) first, with their mean."""
    unused = np.zeros(len(mean))  # dV itself, which the runtime's features begin with: its logarithm says it all
    arrays = {
        "floor": np.asarray(MIN_RATIO),
        "mean": np.concatenate([unused, mean]),
        "scale": np.ones(2 * len(mean)),
        "w1": np.concatenate([np.zeros_like(w1), w1]),
        "b1": b1,
        "w2": w2,
        "b2": b2,
        "w3": w3,
        "b3": b3,
    }
    return {name: np.asarray(value, dtype=np.float32) for name, value in arrays.items()}


def without_common(rows: int) -> Array:
    """Return (r, r - 1) orthonormal directions that a factor common to all rows does not move."""
    basis, _ = np.linalg.qr(np.column_stack([np.ones(rows), np.eye(rows)[:, : rows - 1]]))
    return np.asarray(basis[:, 1:])


def whitening_of(logarithms: Array) -> tuple[Array, Array]:
    """Return the (r,) mean and the (r, r - 1) matrix that gives logarithms of untouched sheets unit covariance.

    A factor common to all rows is not looked at.

    Args:
        logarithms: (n, r).
    """
    directions = without_common(logarithms.shape[1])
    values, own = np.linalg.eigh(np.cov((logarithms @ directions).T))
    # Without the addend a direction in which no noise reaches would be blown up; 1e-4 in log V is below any mesh's.
    return logarithms.mean(axis=0), directions @ (own / np.sqrt(values + 1e-8))
