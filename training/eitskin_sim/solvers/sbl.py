"""Structure-aware sparse Bayesian learning: touched cells come in clusters, and the data decide where.

The image is a sum over all 2 x 2 windows i of the grid of Gaussian patches, whose variances are learned::

    x = sum_i E_i z_i,   z_i ~ N(0, gamma_i B),   B_ab = r^|a - b|_1,   d = A x + noise,   noise ~ N(0, s^2 I)

    EM step   gamma_i <- tr(B^-1 (Sigma_i + mu_i mu_i^T)) / h         h = 4 cells a window
    coupling  gamma_i <- (gamma_i + beta * sum of neighbours) / (1 + beta * number of neighbours)

with mu_i and Sigma_i the posterior of the patch. Sigma_0 couples a cell with its eight neighbours alone and is kept
sparse; of Sigma_i only the trace is asked for, which the whitened operator's columns give pair by pair; the data
covariance C = s^2 I + A Sigma_0 A^T, 104 x 104, is all that is factorised. Without the coupling each step raises the
marginal likelihood; with it, a cell is touched more easily beside touched ones (pattern coupling, paper section V.B).
After the steps the image is the most probable one within bounds, 0 <= x <= upper (:mod:`eitskin_sim.solvers.bounded`);
without bounds it is the posterior mean.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import linalg
from scipy.sparse import coo_array, csr_array

from eitskin_sim.arrays import Array
from eitskin_sim.solvers.bounded import bounded_minimum, inverse

WINDOW: Final = (2, 2)
"""Cluster size 4 (paper section V.B), as a square."""

COUPLING: Final = 0.3
"""Pattern coupling factor (paper section V.B)."""

ITERATIONS: Final = 5
"""EM steps (paper section V.B)."""

TOLERANCE: Final = 1e-4
"""Relative change of the variances that ends the steps (paper section V.B)."""

CORRELATION: Final = 0.5
"""r, between neighbouring cells of a patch; 0.3 and 0.7 differ by 0.01 in CC on random sets."""

NOISE: Final = 0.05
"""s relative to the root mean square of the data: mostly the linearisation's error; 0.03 to 0.1 differ by 0.01."""

MIN_NOISE: Final = 5e-7
"""s is at least this: no instrument reads dV nearer, and C has an inverse however little a sheet is touched."""


@dataclass(frozen=True, slots=True)
class Posterior:
    """What the EM steps leave."""

    variances: Array
    """(windows,) gamma."""
    covariance: Array
    """(n, n) prior covariance Sigma_0 of the image."""
    mean: Array
    """(n,) posterior mean of the image."""
    log_likelihood: tuple[float, ...]
    """Log marginal likelihood before each step, and after the last."""
    noise_variance: float
    """s^2."""


def windows_of(shape: tuple[int, int]) -> npt.NDArray[np.intp]:
    """Return the (windows, h) cells of every window of a grid, windows row by row."""
    rows, columns = (np.arange(n - w + 1) for n, w in zip(shape, WINDOW, strict=True))
    first = (rows[:, None] * shape[1] + columns).ravel()
    inside = (np.arange(WINDOW[0])[:, None] * shape[1] + np.arange(WINDOW[1])).ravel()
    return np.asarray(first[:, None] + inside)


def learn(
    operator: Array,
    data: Array,
    shape: tuple[int, int],
    *,
    coupling: float = COUPLING,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    noise: float = NOISE,
    correlation: float = CORRELATION,
) -> Posterior:
    """Return the learned prior and the posterior mean.

    Args:
        operator: (rows, n) A.
        data: (rows,) d.
        shape: Rows and columns of the n cells.
        coupling: beta; 0 is plain block SBL.
        iterations: EM steps.
        tolerance: Relative change of the variances that ends them.
        noise: s, relative to the data's root mean square.
        correlation: r.

    Raises:
        ValueError: The cells do not fit the operator.
    """
    if operator.shape[1] != shape[0] * shape[1]:
        raise ValueError(f"the operator has {operator.shape[1]} cells, the grid {shape[0]} x {shape[1]}")
    cells = windows_of(shape)
    block, steps = _block(correlation), (shape[0] - WINDOW[0] + 1, shape[1] - WINDOW[1] + 1)
    block_inverse = np.linalg.inv(block)
    noise_variance = max(noise**2 * float(np.mean(data**2)), MIN_NOISE**2)
    variances = np.ones(len(cells))
    likelihoods = []
    for _ in range(iterations):
        whitened, white_data, likelihood, _ = _whiten(operator, data, cells, variances, block, noise_variance)
        likelihoods.append(likelihood)
        mean = variances[:, None] * ((whitened.T @ white_data)[cells] @ block)
        inner = _window_traces(whitened, cells, block)
        second = np.einsum("wa,ab,wb->w", mean, block_inverse, mean) + variances * len(block) - variances**2 * inner
        new = _couple((second / len(block)).reshape(steps), coupling)
        change = float(np.linalg.norm(new - variances) / max(float(np.linalg.norm(variances)), 1e-300))
        variances = new
        if change < tolerance:
            break
    whitened, white_data, likelihood, prior = _whiten(operator, data, cells, variances, block, noise_variance)
    mean = prior @ (whitened.T @ white_data)
    return Posterior(variances, prior.toarray(), mean, (*likelihoods, likelihood), noise_variance)


def sbl_image(
    operator: Array,
    data: Array,
    shape: tuple[int, int],
    *,
    upper: float = np.inf,
    lower: float = 0.0,
    **options: float,
) -> Array:
    """Return the (n,) most probable image within lower <= x <= upper under the learned prior.

    Args:
        operator: (rows, n) A.
        data: (rows,) d.
        shape: Rows and columns of the n cells.
        upper: Largest value of a cell.
        lower: Smallest one.
        options: Of :func:`learn`.
    """
    if not np.any(data):
        return np.zeros(operator.shape[1])
    posterior = learn(operator, data, shape, **options)  # type: ignore[arg-type]
    return bounded_map(operator, data, posterior.covariance, posterior.noise_variance, upper, lower)


def bounded_map(
    operator: Array, data: Array, covariance: Array, noise_variance: float, upper: float, lower: float = 0.0
) -> Array:
    """Return argmin ||A x - d||^2 / s^2 + x^T Sigma_0^-1 x within lower <= x <= upper.

    Args:
        operator: (rows, n) A.
        data: (rows,) d.
        covariance: (n, n) Sigma_0.
        noise_variance: s^2.
        upper: Largest value of a cell.
        lower: Smallest one.

    Raises:
        ValueError: The upper bound is not above the lower one.
    """
    n = operator.shape[1]
    # Cells that no window believes in have a variance near zero: a floor keeps the precision finite, and them at zero.
    floored = covariance + 1e-9 * float(np.trace(covariance)) / n * np.eye(n)
    hessian = inverse(floored)
    hessian += operator.T @ operator / noise_variance
    linear = operator.T @ data / noise_variance
    if not lower:
        return bounded_minimum(hessian, linear, upper)
    return bounded_minimum(hessian, linear - lower * hessian.sum(axis=1), upper - lower) + lower


def _block(correlation: float) -> Array:
    place = np.stack(np.meshgrid(*(np.arange(w) for w in WINDOW), indexing="ij"), axis=-1).reshape(-1, 2)
    return np.asarray(correlation ** np.abs(place[:, None] - place).sum(axis=-1).astype(np.float64))


def _prior(cells: npt.NDArray[np.intp], variances: Array, block: Array, n: int) -> csr_array:
    """Sigma_0 = sum of gamma_i E_i B E_i^T, (n, n)."""
    shape = (*cells.shape, cells.shape[1])
    rows, columns = np.broadcast_to(cells[:, :, None], shape), np.broadcast_to(cells[:, None, :], shape)
    entries = (variances[:, None, None] * block).ravel()
    return coo_array((entries, (rows.ravel(), columns.ravel())), shape=(n, n)).tocsr()


def _whiten(
    operator: Array, data: Array, cells: npt.NDArray[np.intp], variances: Array, block: Array, noise_variance: float
) -> tuple[Array, Array, float, csr_array]:
    """R^-1 A and R^-1 d with C = R R^T, the log marginal likelihood without its constant, and Sigma_0."""
    prior = _prior(cells, variances, block, operator.shape[1])
    covariance = operator @ (prior @ operator.T)
    covariance[np.diag_indices_from(covariance)] += noise_variance
    root = linalg.cholesky(covariance, lower=True)
    whitened = linalg.solve_triangular(root, operator, lower=True, check_finite=False)
    white_data = linalg.solve_triangular(root, data, lower=True, check_finite=False)
    log_determinant = 2.0 * float(np.sum(np.log(np.diag(root))))
    return whitened, white_data, -0.5 * (float(white_data @ white_data) + log_determinant), prior


def _window_traces(whitened: Array, cells: npt.NDArray[np.intp], block: Array) -> Array:
    """(windows,) sum over the cells a, b of a window of B_ab w_a . w_b, with w the whitened operator's columns."""
    total = np.zeros(len(cells))
    products: dict[int, Array] = {}
    for a in range(cells.shape[1]):
        for b in range(a + 1):
            # The same step from cell to cell recurs in all windows: one pass over the columns serves them all.
            step = int(cells[0, a] - cells[0, b])
            if step not in products:
                products[step] = np.einsum("mi,mi->i", whitened[:, : whitened.shape[1] - step], whitened[:, step:])
            total += (1.0 if a == b else 2.0) * block[a, b] * products[step][cells[:, b]]
    return total


def _couple(variances: Array, coupling: float) -> Array:
    if coupling == 0.0:
        return variances.ravel()
    padded, there = np.pad(variances, 1), np.pad(np.ones_like(variances), 1)
    around, count = (a[:-2, 1:-1] + a[2:, 1:-1] + a[1:-1, :-2] + a[1:-1, 2:] for a in (padded, there))
    return np.asarray(((variances + coupling * around) / (1.0 + coupling * count)).ravel())
