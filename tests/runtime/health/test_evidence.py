"""Frames that are looked at together say what they say one by one."""

import numpy as np
import pytest
from tests.runtime.health.test_electrodes import NOISE, REFERENCE, consistency, detached, healthy

from eitskin.health.evidence import N_VOTES, Weigher
from eitskin.health.monitor import BATCH_FRAMES, MAX_BATCH, Health
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS

ALL = np.ones(16, dtype=np.bool_)
NO_SCAN = np.zeros(N_ROWS, dtype=np.float32)


def weigher():
    known = consistency()
    sigma = np.full(N_ROWS, NOISE)
    return Weigher(known.mean, known.precision(), known.ratio_range, REFERENCE, sigma, known.thresholds)


def stream():
    """Return frames with a loose contact, a detached electrode and a short among them."""
    frames = np.concatenate([healthy(11), detached(healthy(13, seed=1), 6), healthy(16, seed=2)])
    frames[26:32, rows_of((9,))] += 0.2 * np.random.default_rng(2).standard_normal((6, 26)).astype(np.float32)
    return frames


@pytest.mark.parametrize("together", [2, 5, 40])
def test_votes_do_not_depend_on_how_many_frames_are_weighed_together(together):
    frames = stream()
    alone, grouped = weigher(), weigher()
    one_by_one = np.concatenate([alone.weigh(frame[None], frame[None], ALL) for frame in frames])
    groups = [frames[first : first + together] for first in range(0, len(frames), together)]
    at_once = np.concatenate([grouped.weigh(group, group, ALL) for group in groups])
    assert one_by_one.shape == (len(frames), N_VOTES)
    assert one_by_one[:, :48].any(axis=0).sum() >= 4  # the stream does say something
    np.testing.assert_array_equal(at_once, one_by_one)


def test_the_surprise_is_the_distance_of_an_electrodes_rows_given_the_others():
    known, change = consistency(), healthy(1)[0]
    logs = np.log1p(change.astype(np.float64))
    surprise, total = weigher().surprise(change[None])
    for electrode in (0, 7):
        mine = rows_of((electrode,))
        block = known.covariance[np.ix_(mine, ~mine)] @ np.linalg.inv(known.covariance[np.ix_(~mine, ~mine)])
        left = known.covariance[np.ix_(mine, mine)] - block @ known.covariance[np.ix_(~mine, mine)]
        apart = logs[mine] - block @ logs[~mine]
        own = apart @ np.linalg.solve(left, apart)
        rest = logs[~mine] @ np.linalg.solve(known.covariance[np.ix_(~mine, ~mine)], logs[~mine])
        # The same number by the covariance instead of the precision; both are inverted once.
        assert surprise[0, electrode] == pytest.approx((own / 26) / ((2 + rest) / 80), rel=1e-6)
    whole = logs @ np.linalg.solve(known.covariance, logs)
    assert total[0] == pytest.approx(whole / N_ROWS, rel=1e-6)


def test_a_frame_that_is_passed_over_quickly_would_have_surprised_nowhere():
    broken = detached(healthy(1), 6)[0]
    weighs = weigher()
    threshold = float(consistency().thresholds[0])
    seen, quick = set(), 0
    for share in np.linspace(0.0, 1.0, 201):  # from a sheet that is the reference to one that lacks an electrode
        frame = (share * broken).astype(np.float32)[None]
        surprise, total = weighs.surprise(frame)
        votes = weighs.weigh(frame, frame, ALL)[0, :16]
        assert votes.any() == (surprise.max() > threshold)
        quick += float(total[0]) * N_ROWS * 80 / 52 < threshold
        seen.add(bool(votes.any()))
    assert seen == {False, True}
    assert 0 < quick < 201
    assert np.array_equal(weighs.evidence().surprise, surprise[0])


def test_frames_are_looked_at_in_any_case_if_the_line_never_rests():
    health = Health(consistency())
    frame = healthy(1)[0]
    must = []
    for _ in range(MAX_BATCH):
        health.prepare(frame.copy())
        must.append(health.put_aside(touched=False))
    assert must == [False] * BATCH_FRAMES + [True]
    assert not health.examine(NO_SCAN)
    assert not health.due


def test_a_row_that_a_touch_leaves_few_counts_may_move_by_one():
    known, size = consistency(), np.abs(REFERENCE)
    row, step = int(size.argmin()), size.min() / 60.0
    rounding = step / size / np.sqrt(12.0)
    weighs = Weigher(known.mean, known.precision(), known.ratio_range, REFERENCE, rounding, known.thresholds)
    change = healthy(1)[0]
    for counts in (3, 4, 3):
        change[row] = counts / 60.0 - 1.0
        assert not weighs.is_mixed_up(change, look=False)
    change[row] = 1.0
    assert weighs.is_mixed_up(change, look=False)


def test_an_electrode_whose_rows_read_nothing_needs_no_surprise():
    known = consistency()
    never = np.full(2, 1e9)
    weighs = Weigher(known.mean, known.precision(), known.ratio_range, REFERENCE, np.full(N_ROWS, NOISE), never)
    frame = healthy(1)
    frame[:, rows_of((6,))] = -0.9999
    assert np.flatnonzero(weighs.weigh(frame, frame, ALL)[0, :16]).tolist() == [6]
