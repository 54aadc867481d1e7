"""Whitened residuals: closed forms, draws of the noise itself, and what a fitted column takes away."""

import numpy as np
import pytest
from scipy import stats

from eitskin_proto.sensor.normalise import relative_change
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.verification.residual import LAWS, Noise, Whitener
from eitskin_sim.verification.verdict import p_value

ROWS = 104
REFERENCE = np.geomspace(0.002, 1.0, ROWS)
CHANGE = np.linspace(-0.9, 1.5, ROWS)


@pytest.mark.parametrize("law", ["N1", "N2", "N3"])
def test_the_stated_deviation_is_that_of_the_noise(law: str) -> None:
    volts = REFERENCE * (1.0 + CHANGE)
    rng = np.random.default_rng(1)
    read = np.array([add_noise(volts, REFERENCE, law, 40.0, rng) for _ in range(4000)])  # type: ignore[arg-type]
    found = relative_change(read, REFERENCE).std(axis=0)
    stated = Noise(law, 40.0).sd(CHANGE, REFERENCE)  # type: ignore[arg-type]
    assert np.allclose(found, stated, rtol=0.06, atol=1e-9)


def test_measured_noise_is_taken_as_it_is_stated() -> None:
    sd = np.full(ROWS, 0.01)
    assert np.array_equal(Noise("measured", measured=sd).sd(CHANGE, REFERENCE), sd)
    with pytest.raises(ValueError, match="needs the rows' standard deviations"):
        Noise("measured")
    with pytest.raises(ValueError, match="take none"):
        Noise("N2", measured=sd)
    with pytest.raises(ValueError, match="'N7' is unknown; expected one of"):
        Noise("N7")  # type: ignore[arg-type]
    assert "measured" in LAWS


def test_what_lies_along_a_column_is_found_as_its_amplitude() -> None:
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((ROWS, 3))
    white = Whitener(np.full(ROWS, 1e-3), columns, floor=0.0)
    value = white.amplitudes(columns @ np.array([1.0, -2.0, 0.5]))
    assert np.allclose(value, [1.0, -2.0, 0.5], atol=1e-4)
    # The same residual is all explained, at the price of the amplitudes themselves.
    assert float(white.chi_squared(columns @ np.array([1.0, -2.0, 0.5]))) == pytest.approx(5.25, abs=1e-3)


def test_missing_rows_leave_the_block_of_the_others() -> None:
    rng = np.random.default_rng(4)
    columns, sd = rng.standard_normal((ROWS, 4)), rng.uniform(0.1, 0.2, ROWS)
    rows = np.arange(ROWS) % 4 > 0
    part = Whitener(sd, columns, rows=rows)
    alone = Whitener(sd[rows], columns[rows])
    assert len(part) == rows.sum()
    assert np.allclose(part.chi_squared(CHANGE), alone.chi_squared(CHANGE[rows]))
    with pytest.raises(ValueError, match="0 rows are left"):
        Whitener(sd, columns, rows=np.zeros(ROWS, dtype=bool))


@pytest.mark.parametrize(("value", "degrees"), [(80.0, 104), (104.0, 104), (190.0, 104), (0.0, 3)])
def test_p_is_the_tail_of_chi_squared(value: float, degrees: int) -> None:
    assert p_value(value, degrees) == pytest.approx(stats.chi2.sf(value, degrees), rel=1e-10)


def test_more_parameters_than_rows_have_no_p() -> None:
    with pytest.raises(ValueError, match="the fit has more parameters than rows"):
        p_value(1.0, 0)
