"""Gates of matched filters: what they are made of, and the same without some rows."""

import numpy as np
import pytest

from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.gate import MIN_FILTER_SHARE, Filters, Gate, patterns_of
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


def test_the_shipped_gates_say_what_they_are_made_of(arrays):
    filters = Filters.of(arrays)
    assert filters is not None
    assert filters.limit > 4
    assert 0 < filters.still < 1
    turned = dict(arrays) | {"b2": np.asarray(arrays["b2"]) + np.arange(len(arrays["b2"]))}
    assert Filters.of(turned) is None


def test_without_rows_it_says_what_it_would_of_the_rows_that_its_own_gaussian_expects(arrays, first, drawn):
    filters = Filters.of(arrays)
    size, (weights, _) = filters.whitened, filters.without(first, LOST)
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


def test_a_filter_s_noise_stays_and_sizes_shrink_by_the_share_that_is_stated(arrays, first, drawn):
    filters = Filters.of(arrays)
    size, (weights, fewer) = filters.whitened, filters.without(first, LOST)
    before, after = (drawn @ one[:-1] + one[-1] for one in (first, weights))
    sizes = [np.abs(one[:, :size]).mean() for one in (before, after)]
    assert sizes[1] / sizes[0] == pytest.approx(fewer.still / filters.still, rel=0.03)
    assert (52 / 103) ** 0.5 - 0.05 < fewer.still / filters.still < 0.85  # two electrodes far apart have 51 rows
    noise = [one[:, size:].std(0) for one in (before, after)]
    assert (noise[1] < 1.06 * noise[0]).all()
    kept = noise[1] > 0.94 * noise[0]
    assert kept.mean() > 0.7  # the others hardly show in the rows that are left
    # a touch is the same touch: without noise each of these filters finds its own pattern best
    patterns = np.linalg.pinv(first[:-1, :size]).T @ patterns_of(first[:-1, :size], first[:-1, size:])
    found = patterns.T @ weights[:-1, size:]
    assert (found.argmax(1) == np.arange(len(found)))[kept].mean() > 0.95
    # which ones are kept is known to a few percent; a pattern of which little is left, to a tenth
    assert (found.diagonal()[kept] > 0.8 * MIN_FILTER_SHARE).all()


def test_a_gate_of_matched_filters_judges_as_the_layers_that_are_stored(arrays):
    gate, rng = Gate(arrays), np.random.default_rng(5)
    stored = {name: np.asarray(value, dtype=np.float64) for name, value in arrays.items()}
    for change in rng.choice([0.01, 0.1, 0.5], (50, 1)) * rng.standard_normal((50, N_ROWS)):
        features = np.concatenate([change, np.log(np.maximum(1.0 + change, stored["floor"]))])
        hidden = np.maximum((features - stored["mean"]) / stored["scale"] @ stored["w1"] + stored["b1"], 0.0)
        hidden = np.maximum(hidden @ stored["w2"] + stored["b2"], 0.0)
        gate.change[:] = change
        touched = gate.touched()
        assert gate.logit == pytest.approx(float(hidden @ stored["w3"] + stored["b3"]), rel=1e-4, abs=1e-3)
        assert touched == (gate.logit > gate.threshold)
        assert gate.logits(change[None])[0] == pytest.approx(gate.logit, rel=1e-5, abs=1e-4)
