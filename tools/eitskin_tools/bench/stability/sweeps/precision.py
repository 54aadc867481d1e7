"""float32 against float64 in every precomputed operator, by regularisation: which must be built in which.

An operator is *built* in float32 when every step of its making is, *rounded* when it is made in float64 and stored as
float32. Building loses the digits that the regularisation lets through: the damped Gram matrix has the condition
1 / factor, so the error is about 6e-8 / factor, and Cholesky finds it indefinite when the factor is below rounding.
Rounding costs 6e-8 whatever the factor. ::

    tikhonov, projection     A^T (A A^T + lambda I)^-1       built
    filling                  P_mm^-1 P_mo, P = (C + lambda I)^-1, of what fills lost rows in: built
    l1, sbl                  iterate on A                    A rounded: what a float32 Jacobian would do
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import linalg

from eitskin.health.imputation import Consistency
from eitskin_export.projection import FACTOR as PROJECTION_FACTOR
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_sim.measurement.consistency import FLOOR
from eitskin_sim.solvers.l1 import FACTOR as L1_FACTOR
from eitskin_sim.solvers.l1 import l1_image
from eitskin_sim.solvers.operators import SATURATED, Cells, Operators, linear_data
from eitskin_sim.solvers.sbl import NOISE, sbl_image
from eitskin_sim.solvers.tikhonov import FACTOR, SENSITIVITY_POWER, tikhonov_matrix
from eitskin_tools.bench.stability.harness.rows import Row, crossing, rounded
from eitskin_tools.bench.stability.harness.samples import Sample
from eitskin_tools.bench.stability.harness.sweep import thinned

Array = npt.NDArray[np.float64]
AnyFloat = npt.NDArray[np.floating]

FACTORS: Final = tuple(10.0**-power for power in range(1, 13))
LOST: Final = 5
"""The electrode whose rows are filled in."""

LIMIT: Final = 1e-3
"""Relative error of an operator that counts as harm: a tenth of what 40 dB noise does to the data."""


def built(operator: Array, factor: float, power: float, dtype: type[np.floating]) -> AnyFloat:
    """Return the (n, rows) Tikhonov matrix with every step taken in one precision.

    Args:
        operator: (rows, n) A.
        factor: Regularisation, relative to the largest eigenvalue.
        power: Of the sensitivities that weigh the cells.
        dtype: float32 or float64.

    Raises:
        LinAlgError: The damped Gram matrix is not positive definite in this precision.
    """
    A = np.asarray(operator, dtype=dtype)
    weight = np.linalg.norm(A, axis=0) ** dtype(power)
    scaled = A / weight
    gram = scaled @ scaled.T
    damped = gram + dtype(factor) * linalg.eigvalsh(gram)[-1] * np.eye(len(gram), dtype=dtype)
    inner = linalg.cho_solve(linalg.cho_factor(damped), scaled)
    found = np.asarray((inner / weight).T)
    assert found.dtype == dtype
    return found


def apart(found: AnyFloat, exact: Array) -> float:
    """Return the relative difference of two arrays in the Frobenius norm; infinite where one is not finite."""
    difference = float(np.linalg.norm(np.asarray(found, dtype=np.float64) - exact) / np.linalg.norm(exact))
    return difference if np.isfinite(difference) else float("inf")


def filling_weights(covariance: Array, factor: float, dtype: type[np.floating]) -> AnyFloat:
    """Return what fills an electrode's rows in from the others, (26, 78), with every step taken in one precision.

    Args:
        covariance: (104, 104) of log(V / V0), without any floor.
        factor: The floor, relative to the largest eigenvalue.
        dtype: float32 or float64.

    Raises:
        LinAlgError: The covariance is singular in this precision.
    """
    floor = factor * np.linalg.eigvalsh(covariance)[-1]
    whole = np.asarray(covariance + floor * np.eye(len(covariance)), dtype=dtype)
    precision, gone = linalg.inv(whole), rows_of((LOST,))
    found = np.asarray(linalg.solve(precision[np.ix_(gone, gone)], precision[np.ix_(gone, ~gone)]))
    assert found.dtype == dtype
    return found


def precision_rows(sample: Sample, levels: int, consistency: Consistency | None = None) -> list[Row]:
    """Return a row for each operator.

    Args:
        sample: Whose bend the operators are of.
        levels: At most so many factors.
        consistency: Of the bundle; without it nothing is filled in.
    """
    factors = thinned(FACTORS, levels)
    rows = []
    choices: tuple[tuple[str, Cells, float, float], ...] = (
        ("tikhonov", "units", SENSITIVITY_POWER, FACTOR),
        ("tikhonov", "pixels", SENSITIVITY_POWER, FACTOR),
        ("projection", "pixels", 0.0, PROJECTION_FACTOR),
    )
    for name, cells, power, shipped in choices:
        operators = sample.sheet.operators(cells)
        singular = np.linalg.svd(operators.relative_jacobian, compute_uv=False)
        rows.append(_tikhonov_row(f"{name}, {cells}, built in float32", operators, power, factors, shipped))
        rows[-1]["why"] += f"; undamped, A A^T has the condition {(singular[0] / singular[-1]) ** 2:.2g}"
    if consistency is not None:
        rows.append(_filling_row(consistency, factors))
    operators = sample.sheet.operators("units")
    data = linear_data(sample.read, sample.sheet.untouched)
    rows.append(
        _iterated_row("l1, units, A rounded to float32", factors, L1_FACTOR,
                      lambda A, factor: l1_image(A, data, factor=factor, upper=SATURATED), operators)
    )  # fmt: skip
    rows.append(
        _iterated_row("sbl, units, A rounded to float32", factors, NOISE**2,
                      lambda A, factor: sbl_image(A, data, operators.shape, upper=SATURATED, noise=factor**0.5),
                      operators)
    )  # fmt: skip
    return rows


def _tikhonov_row(name: str, operators: Operators, power: float, factors: Sequence[float], shipped: float) -> Row:
    A = operators.relative_jacobian
    errors = [_build_error(A, factor, power) for factor in factors]
    once = apart(tikhonov_matrix(A, shipped, power).astype(np.float32), tikhonov_matrix(A, shipped, power))
    at_shipped = _build_error(A, shipped, power)
    verdict = "must be built in float64" if at_shipped > 10.0 * once else "may be built in float32"
    why = (
        f"error about 6e-8 / factor: {at_shipped:.2g} at the shipped factor {shipped:g}, where rounding once costs "
        f"{once:.2g}: {verdict}, may be stored in float32"
    )
    return _row(name, factors, errors, why)


def _build_error(A: Array, factor: float, power: float) -> float:
    try:
        return apart(built(A, factor, power, np.float32), tikhonov_matrix(A, factor, power))
    except linalg.LinAlgError:
        return float("inf")  # indefinite in float32: there is no matrix at all


def _filling_row(consistency: Consistency, factors: Sequence[float]) -> Row:
    covariance = consistency.covariance - FLOOR * np.eye(len(consistency.covariance))
    largest = float(np.linalg.eigvalsh(covariance)[-1])
    shipped = FLOOR / largest

    def error(factor: float) -> float:
        try:
            return apart(filling_weights(covariance, factor, np.float32), _exact_weights(covariance, factor))
        except linalg.LinAlgError:
            return float("inf")

    once = apart(_exact_weights(covariance, shipped).astype(np.float32), _exact_weights(covariance, shipped))
    at_shipped = error(shipped)
    verdict = "must be built in float64" if at_shipped > 10.0 * once else "may be built in float32"
    why = (
        f"P has the condition {1.0 / shipped:.2g} at the shipped floor, {shipped:.2g} of the largest eigenvalue: error "
        f"{at_shipped:.2g}, where rounding once costs {once:.2g}: {verdict}"
    )
    return _row("filling, an electrode's rows, built in float32", factors, [error(factor) for factor in factors], why)


def _exact_weights(covariance: Array, factor: float) -> Array:
    return np.asarray(filling_weights(covariance, factor, np.float64), dtype=np.float64)


def _iterated_row(
    name: str,
    factors: Sequence[float],
    shipped: float,
    solve: Callable[[Array, float], Array],
    operators: Operators,
) -> Row:
    A = operators.relative_jacobian
    rounded_A = A.astype(np.float32).astype(np.float64)
    errors, failed = [], 0
    for factor in factors:
        try:
            errors.append(apart(solve(rounded_A, factor), solve(A, factor)))
        except (ValueError, linalg.LinAlgError):
            errors.append(float("inf"))
            failed += 1
    at_shipped = apart(solve(rounded_A, shipped), solve(A, shipped))
    verdict = "may be stored in float32" if at_shipped < LIMIT else "must be kept in float64"
    why = f"rounding A changes the image by {at_shipped:.2g} at the shipped factor {shipped:.3g}: A {verdict}"
    return _row(name, factors, errors, why + (f"; no image at all at {failed} of the factors" if failed else ""))


def _row(name: str, factors: Sequence[float], errors: Sequence[float], why: str) -> Row:
    kept = [1.0 - error for error in errors]
    finite = [error for error in errors if np.isfinite(error)]
    return {
        "sweep": f"precision: {name}",
        "solver": name.partition(",")[0],
        "unit": "regularisation",
        "from": factors[0],
        "to": factors[-1],
        "unstressed": 1.0,
        "worst": rounded(1.0 - max(finite, default=float("nan"))),
        "worst_at": factors[int(np.argmax(errors))],
        "harmed_at": rounded(crossing(factors, [-error for error in errors], -LIMIT, True)),
        "degrades_10pct_at": rounded(crossing(factors, kept, 0.9, True)),
        "breaks_at": rounded(crossing(factors, kept, 0.5, True)),
        "break_rule": "relative error of the operator or the image above one half, or none at all",
        "why": why,
    }
