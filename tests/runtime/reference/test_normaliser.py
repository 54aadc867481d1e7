import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.reference.normaliser import Normaliser
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.table import RECIPROCAL_IN_FULL, ROW_IN_FULL


def test_change_is_the_relative_change_of_the_shared_definition(counts):
    normaliser, out = Normaliser(2e-9), np.zeros(104, np.float32)
    reference = counts * 1.9e-9
    normaliser.use_reference(reference)
    normaliser.load(counts)
    assert normaliser.change_into(out)
    # float64 until the end: the last digit of float32, of dV + 1, differs at most
    assert np.allclose(out, relative_change(counts * 2e-9, reference), rtol=0, atol=1.2e-7)


def test_reciprocal_pairs_of_a_full_scan_are_averaged(counts):
    full = np.zeros(208, np.int32)
    full[ROW_IN_FULL] = counts + 10
    full[RECIPROCAL_IN_FULL] = counts - 10
    normaliser = Normaliser(1e-9)
    normaliser.load(full)
    assert np.allclose(normaliser.voltages(), counts * 1e-9, rtol=1e-12)


@pytest.mark.parametrize("volts_per_count", [np.nan, np.inf, 1e6])
def test_what_is_not_plausible_is_reported_and_leaves_the_output_alone(counts, volts_per_count):
    normaliser, out = Normaliser(1e-9), np.full(104, 7, np.float32)
    normaliser.use_reference(counts * 1e-9)
    normaliser.use_scale(volts_per_count)
    normaliser.load(counts)
    assert not normaliser.change_into(out)
    assert np.all(out == 7)


@given(
    seed=st.integers(0, 2**32 - 1),
    volts_per_count=st.floats(5e-324, 1e30),
    largest_V=st.floats(1e-30, 1e30),
    full=st.booleans(),
)
def test_no_counts_and_no_reference_make_a_change_that_is_small_but_not_0(seed, volts_per_count, largest_V, full):
    rng = np.random.default_rng(seed)
    reference = largest_V * rng.uniform(-1, 1, 104) * 10.0 ** rng.uniform(-8, 0, 104)
    reference[rng.random(104) < 0.1] *= rng.choice([0.0, 1e-300])
    reference[rng.integers(104)] = largest_V
    counts = rng.integers(-(2**31), 2**31, 208 if full else 104, dtype=np.int32)
    near = rng.random(len(counts)) < 0.7  # where dV comes closest to 0
    with np.errstate(all="ignore"):
        exact = np.rint(np.resize(reference, len(counts)) / volts_per_count) + rng.integers(-1, 2, len(counts))
    counts[near] = np.clip(exact[near], -(2**31), 2**31 - 1).astype(np.int32)
    if full:
        counts[RECIPROCAL_IN_FULL] = counts[ROW_IN_FULL]
    normaliser, out = Normaliser(volts_per_count), np.zeros(104, np.float32)
    normaliser.use_reference(reference)
    normaliser.load(counts)
    with np.errstate(all="ignore"):
        normaliser.change_into(out)
    size = np.abs(out[out != 0.0])
    assert not size.size or size.min() >= 2.0**-53
