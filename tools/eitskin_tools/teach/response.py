"""Learns the response field: what a press at each place does to the rows, a Gaussian process with few settings.

A press i at x_i, of an unknown amplitude s_i of mean 1, changes the rows by ::

    d_i = s_i f(x_i) + e_i          e_i ~ N(0, C / w_i)         w_i small for an odd press, as Student's t has it

Directions are rotated so that C is the identity and the whitened presses' principal axes are the axes. Along each axis
j the field is a process of its own, with the variance ``scales[j]`` and one length scale for all ::

    f_j(x) = b phi_j(x) + N(0, scales[j] exp(-|x - x'|^2 / 2 length^2))

With the eigenvalues of the places' kernel every likelihood is a sum. Length and scales have the largest marginal
likelihood; an axis that is likelier to hold noise alone is left out. phi is what physics expects, if anything
(:mod:`eitskin_tools.teach.physics`); its weight b has the largest likelihood too, and is 0 where that gains too little.
The four steps are repeated: scales and length; amplitudes; weights w_i; and C from what is left, shrunk to its
diagonal as much as its own scatter asks for.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LENGTHS_OF_SIZE: Final = np.geomspace(0.06, 0.35, 8)
"""Length scales that are tried, over the sheet's shorter side."""

SCALES: Final = np.geomspace(0.01, 1000.0, 24)
"""Variances of the field along an axis that are tried, over that of noise."""

COMPARED_LENGTH: Final = 0.2
"""Length scale, over the sheet's shorter side, by which own places are compared with shuffled ones."""

SHUFFLES: Final = 40
"""With which they are compared."""

ROUNDS: Final = 6
"""Repetitions of the four steps."""

MOST_AXES: Final = 48
"""Principal axes that are looked at."""

MOST_COMPARED: Final = 300
"""Presses by which the length scale is chosen."""

FREEDOM: Final = 20.0
"""Of Student's t: an odd press has a smaller weight, an ordinary one about 1."""

AMPLITUDES: Final = (0.2, 4.0)
"""Of a press, over the mean."""

LEAST_SIGNAL: Final = 0.1
"""Mean square along an axis, over that of noise, which physics must expect for the axis to be used."""

PRIOR_ROUNDS: Final = 4
"""How often its weight and the scales are found in turn."""

PRIOR_GAIN: Final = 10.0
"""What physics must add to the log likelihood to be used."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """A learned field."""

    project: Array
    """(rows, q) from the rows to the axes."""
    length_mm: float
    scales: Array
    """(q,) variance of the field along each axis, over that of noise."""
    amplitude_sd: float
    """Of presses, whose mean is 1."""
    prior_weight: float
    """b; 0 where physics does not help."""
    places_mm: Array
    """(n, 2) of the presses."""
    _strength: Array
    """(n,) amplitude times the root of the weight."""
    _values: Array
    _vectors: Array
    """Of the presses' kernel: (n,) eigenvalues and (n, n) eigenvectors."""
    _answer: Array
    """(n, q): the field is kernel times this."""

    def at(self, places_mm: Array, prior: Array | None = None) -> tuple[Array, Array]:
        """Return the field and its variance, (m, q) each.

        Args:
            places_mm: (m, 2)
            prior: (m, rows) what physics expects there; needed where it was learned with.
        """
        kernel = _kernel(places_mm, self.places_mm, self.length_mm) * self._strength
        field = kernel @ self._answer
        if self.prior_weight and prior is not None:
            field += self.prior_weight * (prior @ self.project)
        return field, _variance(kernel @ self._vectors, self._values, self.scales)


def learn(changes: Array, places_mm: Array, size_mm: tuple[float, float], prior: Array | None = None) -> Response:
    """Return the field of recorded presses.

    Args:
        changes: (n, rows) log(V / V_untouched) of each press.
        places_mm: (n, 2)
        size_mm: Of the sheet.
        prior: (n, rows) what physics expects of each; None for nothing.
    """
    n = len(changes)
    amplitudes, weights, amplitude_sd = np.ones(n), np.ones(n), 0.3
    lengths = LENGTHS_OF_SIZE * min(size_mm)
    covariance = shrunk(changes, 0.5)
    compared = np.random.default_rng(0).permutation(n)[:MOST_COMPARED]
    found: Response | None = None
    for turn in range(ROUNDS):
        root = np.sqrt(weights)
        signals = changes * root[:, None]
        if prior is not None and found is not None and found.prior_weight:
            signals = np.concatenate([signals, found.prior_weight * prior])
        axes = _axes(signals, covariance)
        data, strength = changes @ axes, amplitudes * root
        expected = None if prior is None else (prior @ axes) * strength[:, None]
        if found is not None:
            ratio = lengths / found.length_mm
            lengths = lengths[(ratio > 0.6) & (ratio < 1.7)]  # neighbours of the last best one
        length = lengths[0]
        if len(lengths) > 1:
            trials = [
                _Evidence(
                    root[compared, None] * data[compared],
                    _kernel(places_mm[compared], places_mm[compared], one)
                    * np.outer(strength, strength)[compared][:, compared],
                    None if expected is None else expected[compared],
                )
                for one in lengths
            ]
            length = lengths[int(np.argmax([one.log_likelihood for one in trials]))]
        kernel = _kernel(places_mm, places_mm, length)
        best = _Evidence(root[:, None] * data, kernel * np.outer(strength, strength), expected)
        kept = best.scales > 0.0
        if prior is not None:
            kept |= ((best.prior_weight * prior @ axes) ** 2).mean(axis=0) > LEAST_SIGNAL
        project, scales = axes[:, kept], best.scales[kept]
        found = Response(
            project, float(length), scales, amplitude_sd, best.prior_weight, places_mm, strength, best.values,
            best.vectors, best.answer[:, kept],
        )  # fmt: skip
        if turn == ROUNDS - 1:
            break
        field, variance = found.at(places_mm, prior)
        precision = amplitude_sd**-2
        norm = weights * (field**2 + variance).sum(axis=1) + precision
        amplitudes = (weights * (data[:, kept] * field).sum(axis=1) + precision) / norm
        amplitudes = np.clip(amplitudes, *AMPLITUDES)
        amplitude_sd = float(np.sqrt(np.mean((amplitudes - 1.0) ** 2 + 1.0 / norm)))
        amplitudes /= amplitudes.mean()
        # what is left at the presses themselves is too small, by the share of freedom that the field took
        fitted = amplitudes[:, None] * field
        left = data[:, kept] - fitted
        swollen = left / np.sqrt(np.maximum(1.0 - best.freedom[kept] / n, 0.05))
        weights = (FREEDOM + scales.size) / (FREEDOM + (swollen**2).sum(axis=1))
        residual = changes - (fitted + left - swollen) @ np.linalg.pinv(project)
        covariance = shrunk(residual * np.sqrt(weights)[:, None])
    assert found is not None
    return found


def dependence_on_place(changes: Array, places_mm: Array, size_mm: tuple[float, float]) -> float:
    """Return the share of shuffled places by which presses are explained worse than by their own.

    Args:
        changes: (n, rows)
        places_mm: (n, 2)
        size_mm: Of the sheet.
    """
    few = np.random.default_rng(0).permutation(len(changes))[:MOST_COMPARED]
    changes, places_mm = changes[few], places_mm[few]
    data = changes @ _axes(changes, shrunk(changes, 0.5))
    evidence = _Evidence(data, _kernel(places_mm, places_mm, COMPARED_LENGTH * min(size_mm)), None)
    own, rng = evidence.log_likelihood, np.random.default_rng(0)
    return float(np.mean([evidence.of(data[rng.permutation(len(data))]) < own for _ in range(SHUFFLES)]))


class _Evidence:
    """The likeliest variances of the field along each axis, given a kernel.

    Args:
        data: (n, axes) with unit noise.
        kernel: (n, n) of the field, with amplitudes.
        expected: (n, axes) what physics expects; None for nothing.
    """

    def __init__(self, data: Array, kernel: Array, expected: Array | None) -> None:
        values, self.vectors = np.linalg.eigh(kernel)
        self.values = np.maximum(values, 0.0)
        self.prior_weight, self.log_likelihood = 0.0, 0.0
        self.scales: Array = np.zeros(data.shape[1])
        data = self.vectors.T @ data
        self._fit(data)
        if expected is not None:
            expected = self.vectors.T @ expected
            alone = self.log_likelihood
            self.scales = np.zeros_like(self.scales)  # begin where physics explains all of it
            for _ in range(PRIOR_ROUNDS):
                noise = 1.0 / (self.values[:, None] * self.scales + 1.0)
                weight = float((noise * data * expected).sum() / (noise * expected**2).sum())
                self._fit(data - weight * expected)
            if self.log_likelihood > alone + PRIOR_GAIN:
                self.prior_weight = weight
                data = data - weight * expected
            else:
                self._fit(data)
        share = self.scales / (self.values[:, None] * self.scales + 1.0)
        self.answer = self.vectors @ (data * share)
        """(n, axes): the field is kernel times this."""
        self.freedom = (share * self.values[:, None]).sum(axis=0)
        """(axes,) degrees of freedom that the field takes."""

    def of(self, data: Array) -> float:
        """Return the log likelihood of other data, with the best variances for them."""
        self._fit(self.vectors.T @ data)
        return self.log_likelihood

    def _fit(self, data: Array) -> None:
        spread = SCALES[:, None] * self.values + 1.0
        squares = data**2
        tried = -0.5 * (1.0 / spread) @ squares - 0.5 * np.log(spread).sum(axis=1, keepdims=True)
        none = -0.5 * squares.sum(axis=0)
        best = tried.max(axis=0)
        self.scales = np.where(best > none, SCALES[tried.argmax(axis=0)], 0.0)
        self.log_likelihood = float(np.maximum(best, none).sum())


def _axes(changes: Array, covariance: Array) -> Array:
    """Return (rows, axes): directions with unit noise, the principal ones of the whitened presses."""
    values, vectors = np.linalg.eigh(covariance)
    white = vectors / np.sqrt(np.maximum(values, values[-1] * 1e-9))
    principal = np.linalg.svd(changes @ white, full_matrices=False)[2]
    return np.asarray(white @ principal[:MOST_AXES].T)


def shrunk(samples: Array, share: float | None = None) -> Array:
    """Return the (rows, rows) covariance about 0, its correlations shrunk.

    Args:
        samples: (n, rows)
        share: By how much; None as the scatter of the correlations asks for (Schaefer and Strimmer 2005).
    """
    n, rows = samples.shape
    size = np.sqrt((samples**2).mean(axis=0))
    size = np.maximum(size, max(float(size.max()) * 1e-6, 1e-12))
    unit = samples / size
    correlation = unit.T @ unit / n
    if share is None:
        scatter = ((unit**2).T @ unit**2 / n - correlation**2) / n
        off = ~np.eye(rows, dtype=bool)
        share = float(np.clip(scatter[off].sum() / max((correlation[off] ** 2).sum(), 1e-300), 0.0, 1.0))
    correlation *= 1.0 - share
    np.fill_diagonal(correlation, 1.0)
    return np.asarray(correlation * np.outer(size, size))


def _kernel(one_mm: Array, other_mm: Array, length_mm: float) -> Array:
    squares = ((one_mm[:, None] - other_mm[None]) ** 2).sum(axis=-1)
    return np.asarray(np.exp(squares / (-2.0 * length_mm**2)))


def _variance(rotated: Array, values: Array, scales: Array) -> Array:
    """Return (m, q) what the presses leave open of the field."""
    known = rotated**2 @ (1.0 / (values[:, None] * scales + 1.0))
    return np.asarray(np.maximum(scales - scales**2 * known, 0.0))
