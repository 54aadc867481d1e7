"""Rows that no sheet reads, and frames that do not come twice."""

import numpy as np
import pytest

from eitskin.errors import BadReference
from eitskin.reference.builder import MOST_UNFIT, ReferenceBuilder
from eitskin.reference.front_end import MAX_CUT_OFF, stuck
from eitskin.reference.repeats import Repeats
from eitskin_proto.sensor.table import TABLE

from .capturing import capture

FULL_SCALE = 2**23 - 1


@pytest.fixture
def frames(counts):
    rng = np.random.default_rng(3)
    return np.rint(counts * (1 + 2e-3 * rng.standard_normal((50, 104)))).astype(np.int32)


def captured(frames, hello, force=False):
    return capture(frames * hello.volts_per_count, hello, force=force)


def test_rows_of_a_sheet_are_well(counts, frames):
    assert not any(stuck(frame, counts) or stuck(frame) for frame in frames)


@pytest.mark.parametrize("value", [FULL_SCALE, -FULL_SCALE - 1, 12_345, 1])
def test_a_converter_that_reads_one_count_is_stuck(counts, value):
    assert "104 of 104 rows share counts" in stuck(np.full(104, value), counts)


def test_dead_rows_and_a_few_that_are_cut_off_are_no_lie(counts):
    frame = counts.copy()
    frame[20:] = 0
    assert not stuck(frame, counts)
    frame = counts.copy()
    frame[60 : 60 + MAX_CUT_OFF + 1] = FULL_SCALE
    few, many = (sum(1 << (60 + row) for row in range(count)) for count in (MAX_CUT_OFF, MAX_CUT_OFF + 1))
    assert not stuck(frame, counts, few, FULL_SCALE)
    assert "cut off at" in stuck(frame, counts, many, FULL_SCALE)
    assert not stuck(frame, counts * 20.0, many, FULL_SCALE)  # rows near full scale may be driven beyond it


@pytest.mark.parametrize("column", [0, 1])
def test_a_multiplexer_that_is_stuck_shows_although_there_is_noise(counts, column):
    rng = np.random.default_rng(1)
    read = np.geomspace(4e6, 1e4, 16)[TABLE[:, column]] * (1 + 3e-3 * rng.standard_normal(104))
    assert "are identical" in stuck(np.rint(read), counts)


def test_a_reference_of_frames_that_are_all_the_same_is_refused_unless_forced(frames, hello):
    with pytest.raises(BadReference, match=r"all 50 frames are the same bit by bit.*--force"):
        captured(frames[:1].repeat(50, axis=0), hello)
    found = captured(frames[:1].repeat(50, axis=0), hello, force=True)
    assert any("all its frames are identical" in line for line in found.report())
    assert not any("cannot be told" in line for line in captured(frames, hello).report())


def test_a_front_end_that_hangs_now_and_then_or_in_some_rows_has_no_reference(frames, hello):
    hung = frames.copy()
    hung[30:35] = hung[29]
    with pytest.raises(BadReference, match=r"rows .* repeat their reading"):
        captured(hung, hello)
    for since in (0, 30):
        hung = frames.copy()
        hung[since:, 10:60] = hung[since, 10:60]
        with pytest.raises(BadReference, match="rows 10-59 repeat their reading"):
            captured(hung, hello)


@pytest.mark.parametrize("rows", [slice(None, None, 2), slice(0, 13)])
def test_a_reference_of_mixed_signs_is_refused_unless_forced(frames, hello, rows):
    frames[:, rows] *= -1
    with pytest.raises(BadReference, match="rows of the reference have the other sign"):
        captured(frames, hello)
    assert captured(frames, hello, force=True)
    assert captured(-np.abs(frames), hello)


@pytest.mark.parametrize("force", [False, True])
def test_a_reference_of_rows_that_are_alike_is_refused_even_if_forced(hello, force):
    rng = np.random.default_rng(0)
    with pytest.raises(BadReference, match=r"does not come from a sheet: 104 of 104 rows share counts.*stuck"):
        captured(np.full((50, 104), FULL_SCALE) - rng.integers(0, 50, (50, 1)), hello, force=force)


def test_frames_that_are_not_fit_end_a_capture_with_what_was_wrong():
    builder = ReferenceBuilder(10)
    for _ in range(MOST_UNFIT - 1):
        builder.leave_out("rows are cut off")
    with pytest.raises(BadReference, match=r"200 frames could not be used.*because rows are cut off"):
        builder.leave_out("rows are cut off")


@pytest.mark.slow
@pytest.mark.parametrize(("own", "level", "shared"), [
    (3e-3, 0.0, 0.0), (0.0, 30.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.3, 0.0), (3e-5, 1.0, 3e-3), (1e-4, 0.0, 0.0),
])  # fmt: skip
def test_of_720_000_honest_frames_that_drift_none_hangs(own, level, shared):
    seed, each, size = 5, 120_000, np.geomspace(1.6e4, 33.0, 104)
    print(f"seed {seed}")
    rng, watch, blamed = np.random.default_rng(seed), Repeats(104), 0
    for first in range(0, each, 4000):
        at = (first + np.arange(4000.0))[:, None]
        drift = 0.03 * np.sin(at / 30_000.0) + 0.005 * np.sin(at / 50_000.0 + np.arange(104.0))
        noise = own * rng.standard_normal((4000, 104)) + shared * rng.standard_normal((4000, 1))
        frames = np.rint(size * (1.0 + drift + noise) + level * rng.standard_normal((4000, 104)))
        if not first:
            watch.use_reference(size, frames[:100].std(axis=0), 32_767.0)
        blamed += sum(watch.add(frame) and (watch.is_old(frame, 0, 1) or watch.hanging.any()) for frame in frames)
    assert blamed == 0
