"""References of bent, touched and moving sheets; solved ones are in tests/sim/measurement."""

import numpy as np
import pytest

from eitskin.errors import BadReference
from eitskin.model.bundle import load_bundle
from eitskin.reference.judged import ReferenceChecks, reference_checks
from eitskin.reference.movement import movement_of

from .capturing import capture

LEVEL = 10.0 ** (-50.0 / 20.0)


@pytest.fixture(scope="module")
def bundle():
    return load_bundle()


@pytest.fixture(scope="module")
def flat(bundle):
    """Return (104,) V of the flat, untouched sheet under 1 mA."""
    return 1e-3 * np.asarray(bundle.consistency_arrays()["reference"], dtype=np.float64)


@pytest.fixture(scope="module")
def bends(bundle):
    """Return (40, 104) factors by which deformations change the voltages, as the bundle knows them."""
    arrays = bundle.consistency_arrays()
    rng = np.random.default_rng(6)
    return np.exp(rng.multivariate_normal(arrays["untouched_mean"], arrays["untouched_covariance"], 40))


def frames_of(voltages, kind="N2", count=100, seed=0):
    """Return (count, 104) V with noise of 50 dB: of every row by its own size, or of one level for all."""
    draw = np.random.default_rng(seed).standard_normal((count, 104))
    size = np.abs(voltages) if kind == "N2" else np.sqrt(np.mean(voltages**2, axis=-1, keepdims=True))
    return voltages + LEVEL * size * draw


@pytest.mark.parametrize("kind", ["N2", "N3"])
@pytest.mark.parametrize("count", [10, 100])
def test_honest_captures_are_taken_without_a_word_and_again_against_the_first(bundle, flat, hello, kind, count):
    for seed in range(8):
        first = capture(frames_of(flat, kind, count, seed), hello, reference_checks(bundle))
        again = capture(frames_of(flat, kind, count, 100 + seed), hello, reference_checks(bundle, first))
        assert (first.judgement.refusals, first.judgement.remarks) == ((), ())
        assert (again.judgement.refusals, again.judgement.remarks) == ((), ())
        assert again.judgement.movement == 0.0
        assert again.judgement.touched is False


@pytest.mark.slow
def test_gross_bends_are_refused_against_the_model_and_most_against_an_older_reference(bundle, flat, bends, hello):
    older = capture(frames_of(flat), hello)
    gross = 0
    for factor in bends:
        shape = np.log(factor) - np.median(np.log(factor))
        rms = np.sqrt(np.mean(shape**2))
        for bound, checks in ((0.20, reference_checks(bundle)), (0.10, reference_checks(bundle, older))):
            if rms > 1.1 * bound:
                gross += 1
                with pytest.raises(BadReference, match=r"leave the sheet flat, untouched and at rest.*--force"):
                    capture(frames_of(flat * factor), hello, checks)
    assert gross > 30


def test_a_common_factor_of_current_or_wetness_is_no_reason(bundle, flat, hello):
    older = capture(frames_of(flat), hello)
    for factor in (0.2, 0.8, 1.3, 1000.0):
        found = capture(frames_of(flat * factor), hello, reference_checks(bundle))
        assert found.judgement.remarks == ()
    dry = capture(frames_of(flat * 1.3), hello, ReferenceChecks(older=older))
    assert dry.judgement.older_difference == pytest.approx(0.0, abs=2e-3)


def test_a_refusal_names_the_order_that_rows_have(bundle, flat, hello):
    late = np.roll(flat, 1)
    with pytest.raises(BadReference, match="the rows are not in the stated order: readings come 1 row late"):
        capture(frames_of(late), hello, reference_checks(bundle))


def test_force_takes_it_and_says_what_was_found(bundle, flat, hello):
    bent = flat * np.exp(0.4 * np.sin(np.arange(104)))
    found = capture(frames_of(bent), hello, reference_checks(bundle), force=True)
    assert found.judgement.refusals
    assert "differs from the bundle's flat, untouched sheet by" in found.report()[1]
    assert "a bundle of its own: --bundle FILE" in found.report()[1]
    assert found.answer()["remarks"] == list(found.judgement.refusals)
    assert {"frames", "weak_rows", "median_spread", "movement", "model_difference"} <= set(found.answer())


def test_a_touch_is_told_by_the_gate_against_the_older_reference(bundle, flat, hello):
    older = capture(frames_of(flat), hello)
    checks = reference_checks(bundle, older)
    columns = bundle.tikhonov()[15 * 45 + 20]  # rows that a touch near the middle changes, by the projection
    touched = flat * (1.0 + 0.25 * columns / np.abs(columns).max())
    with pytest.raises(BadReference, match="the sheet is touched, by the bundle's gate"):
        capture(frames_of(touched), hello, checks)


@pytest.mark.parametrize("kind", ["N2", "N3"])
def test_a_sheet_that_bends_while_it_is_captured_is_refused(flat, bends, hello, kind):
    for factor in bends[:10]:
        way = np.linspace(0.0, 0.25, 100)[:, None]  # a quarter of the bend within the capture
        with pytest.raises(BadReference, match=r"moved by \d+\.\d% while the reference was captured"):
            capture(frames_of(flat * factor**way, kind), hello)


def test_a_touch_that_comes_while_it_is_captured_is_refused(flat, hello):
    touched = flat * (1.0 - 0.2 * np.exp(-((np.arange(104) - 50.0) ** 2) / 200.0))
    frames = np.where(np.arange(100)[:, None] < 70, flat, touched)
    with pytest.raises(BadReference, match="moved by"):
        capture(frames_of(frames), hello)


@pytest.mark.parametrize("count", [2, 9, 100])
def test_noise_that_is_the_same_in_all_rows_is_no_movement(flat, count):
    moved = 0
    for seed in range(50):
        common = 1.0 + 0.004 * np.random.default_rng(seed).standard_normal((count, 1))
        moved += movement_of(flat * common) > 0.005
    assert moved == 0


def test_movement_is_as_large_as_it_is(flat):
    movement = movement_of(flat * (1.0 + 0.06 * np.linspace(0.0, 1.0, 100)[:, None]))
    # means of ten parts of a ramp lie ten of its 99 steps apart; of ten such it is sqrt(110 / 12) times
    assert movement == pytest.approx(0.06 * 10 / 99 / 1.03 * np.sqrt(110 / 12), rel=1e-3)
