"""Gates of matched filters: what they are made of, and the same without some rows."""

import numpy as np
import pytest

from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.gate import Filters, Gate, patterns_of
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS

LOST = rows_of((2, 11))


@pytest.fixture(scope="module", params=["raise", "lower"])
def arrays(request):
    found = load_bundle(default_path(touches=request.param)).gate_arrays()
    if found is None:
        pytest.skip("the shipped bundle has no gate; 'eitskin export' makes one")
    return found


@pytest.fixture
def first(arrays):
    """The (105, h) weights and bias that make responses of logarithms."""
    scale = np.asarray(arrays["scale"], dtype=np.float64)[N_ROWS:, None]
    weights = np.asarray(arrays["w1"], dtype=np.float64)[N_ROWS:] / scale
    bias = np.asarray(arrays["b1"], dtype=np.float64) - np.asarray(arrays["mean"], dtype=np.float64)[N_ROWS:] @ weights
    return Filters.of(arrays).once(np.vstack([weights, bias[None]]))


@pytest.fixture
def drawn(arrays, first):
    """Return (4000, 104) logarithms of the gate's own Gaussian: w is white."""
    size = Filters.of(arrays).whitened
    white = np.random.default_rng(3).standard_normal((4000, size)) - first[-1, :size]
    return white @ np.linalg.pinv(first[:-1, :size])


def test_without_rows_it_says_what_it_would_of_the_rows_that_its_own_gaussian_expects(arrays, first, drawn):
    filters = Filters.of(arrays)
    size, (weights, *_) = filters.whitened, filters.without(first, LOST)
    assert not weights[:-1][LOST].any()
    whitening, bias = first[:-1, :size], first[-1, :size]
    precision = whitening @ whitening.T
    mean = -np.linalg.lstsq(whitening.T, bias, rcond=None)[0]
    filled = drawn[:50].copy()
    back = np.linalg.solve(precision[np.ix_(LOST, LOST)], precision[np.ix_(LOST, ~LOST)])
    filled[:, LOST] = mean[LOST] - (filled[:, ~LOST] - mean[~LOST]) @ back.T
    expected = filled @ whitening + bias
    found = drawn[:50] @ weights[:-1, :size] + weights[-1, :size]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def test_a_gate_of_matched_filters_judges_as_the_layers_that_are_stored(arrays):
    gate, rng = Gate(arrays), np.random.default_rng(5)
    stored = {name: np.asarray(value, dtype=np.float64) for name, value in arrays.items()}
    for change in rng.choice([0.01, 0.1, 0.5], (50, 1)) * rng.standard_normal((50, N_ROWS)):
        features = np.concatenate([change, np.log(np.maximum(1.0 + change, stored["floor"]))])
        hidden = np.maximum((features - stored["mean"]) / stored["scale"] @ stored["w1"] + stored["b1"], 0.0)
        hidden = np.maximum(hidden @ stored["w2"] + stored["b2"], 0.0)
        gate.change[:] = change
        gate.reset()
        touched = gate.touched()
        assert gate.logit == pytest.approx(float(hidden @ stored["w3"] + stored["b3"]), rel=1e-4, abs=1e-3)
        assert touched == (gate.logit > gate.threshold)
        assert gate.logits(change[None])[0] == pytest.approx(gate.logit, rel=1e-5, abs=1e-4)


def test_a_touch_that_is_held_while_rows_go_missing_stays_and_its_end_is_none(arrays, first):
    gate, rng, size = Gate(arrays), np.random.default_rng(6), Filters.of(arrays).whitened
    pattern = patterns_of(first[:-1, :size], first[:-1, size:])[:, 0]
    press = 8.0 * pattern / np.linalg.norm(pattern) @ np.linalg.pinv(first[:-1, :size])

    def said(logs, wild=0.0):
        gate.change[:] = np.expm1(logs + 0.001 * rng.standard_normal(N_ROWS)) + wild * LOST
        return gate.touched()

    assert not any(said(0.0) for _ in range(50))
    assert all(said(press) for _ in range(20))
    for _ in range(3):  # they fail before they are found out
        said(press, wild=3.0)
    assert gate.leave_out(LOST)
    assert all(said(press, wild=3.0) for _ in range(50))
    assert not any([said(0.0) for _ in range(50)][4:])
