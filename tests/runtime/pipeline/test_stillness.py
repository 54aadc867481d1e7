"""Frames between which only noise lies: how often they are recognised, and what they cost a subscriber."""

import numpy as np
import pytest

import eitskin
from eitskin.errors import FrameError
from eitskin.messaging.frame import MapMissing, unpack_frame
from eitskin.messaging.frame_message import FramePacker
from eitskin.messaging.publish import Publisher
from eitskin.model.stillness import REFRESH_FRAMES, Stillness
from eitskin_proto.skin.skin import PAPER

from ..messaging.publishing import wait_for

VOLTS = 1e-3 * np.geomspace(1, 0.01, 104) * np.where(np.arange(104) % 2, -1, 1)
SPREAD = 0.003 * np.abs(VOLTS)


@pytest.fixture
def stillness():
    found = Stillness()
    found.use_reference(VOLTS, SPREAD, 100_000)
    return found


def noise(rng, count):
    return (0.003 * rng.standard_normal((count, 104))).astype(np.float32)


def test_noise_alone_is_still_and_is_taken_for_a_change_as_rarely_as_stated(stillness):
    rng = np.random.default_rng(0)
    kept, frames = noise(rng, 400), noise(rng, 400 * 50)
    wrong = 0
    for index, start in enumerate(kept):
        stillness.keep(start)
        wrong += sum(not stillness.still(frame) for frame in frames[50 * index : 50 * (index + 1)])
    # 1 in 4000 for independent pairs; a kept frame is shared by 50 pairs, so the count scatters more than Poisson
    assert wrong < 20_000 / 4000 * 4


def test_a_change_of_three_sigmas_a_row_is_seen_at_once_and_one_of_a_third_is_not(stillness):
    rng = np.random.default_rng(1)
    direction = np.where(rng.random(104) < 0.5, -1, 1).astype(np.float32)
    stillness.keep(noise(rng, 1)[0])
    assert not any(stillness.still(frame + 0.009 * direction) for frame in noise(rng, 30))
    assert sum(stillness.still(frame + 0.001 * direction) for frame in noise(rng, 30)) >= 28


def taken(stillness, frames):
    """Take frames as the runtime does; return the number, the mean and its count of frames wherever a map is due."""
    found = []
    for number, frame in enumerate(frames):
        if stillness.take(frame):
            found.append((number, stillness.mean.astype(float), stillness.frames))
    return found


def test_a_map_is_due_at_each_doubling_of_the_mean_and_then_of_the_newest_frames_alone(stillness):
    frames = noise(np.random.default_rng(4), 200)
    found = taken(stillness, frames)
    assert [(number + 1, count) for number, _, count in found] == [
        (1, 1), (2, 2), (4, 4), (8, 8), (16, 16), (32, 32), (64, 64), (128, 64), (192, 64)
    ]  # fmt: skip
    for number, mean, count in found:
        assert mean == pytest.approx(frames[number + 1 - count : number + 1].mean(axis=0), abs=1e-8)


def test_where_drift_takes_over_ends_the_mean(stillness):
    stillness.use_reference(VOLTS, SPREAD, 100_000, most=4)
    counts = [count for _, _, count in taken(stillness, noise(np.random.default_rng(4), 300))]
    assert counts == [1, 2, 4, 4, 4]


def test_a_step_of_three_standard_errors_of_a_place_drops_the_mean_within_sixteen_frames(stillness):
    rng, stale = np.random.default_rng(4), 0
    for before in range(64, 164):
        stillness.reset()
        taken(stillness, noise(rng, before))
        direction = rng.standard_normal(104)
        step = 0.003 * 3.5 * direction / np.linalg.norm(direction)  # the strength is in doubt too
        taken(stillness, noise(rng, 16) + step.astype(np.float32))
        stale += stillness.frames > 16
    assert stale <= 10


def test_noise_that_rows_share_ends_no_mean_and_hides_no_step(stillness):
    rng, together = np.random.default_rng(4), 0.009 * np.abs(VOLTS)
    stillness.use_reference(VOLTS, np.hypot(SPREAD, together), 100_000, shared_V=together[:, None])
    frames = noise(rng, 3000) + 0.009 * rng.standard_normal((3000, 1)).astype(np.float32)
    counts = [count for _, _, count in taken(stillness, frames)]
    assert counts.count(1) <= 1 + 3000 / 4000 * 4
    assert counts.count(64) > 20
    step = 0.006 * np.where(rng.random(104) < 0.5, -1, 1).astype(np.float32)
    assert [count for _, _, count in taken(stillness, frames[:1] + step)] == [1]


@pytest.mark.parametrize("level", [1e-4, 3e-4, 1e-3, 3e-3])
def test_what_creeps_at_1_mm_a_second_is_never_farther_from_the_sheet_than_one_frame_is(stillness, level):
    stillness.use_reference(VOLTS, level * np.abs(VOLTS), 100_000)
    rng, rows = np.random.default_rng(5), np.linspace(0.0, 80.0, 104)
    seen = np.zeros(104)
    fused, single, held = [], [], np.zeros(104)
    for number in range(1000):  # five seconds
        truth = 0.3 * np.exp(-0.5 * ((rows - 30.0 - number / 200.0) / 8.0) ** 2)
        frame = (truth + level * rng.standard_normal(104)).astype(np.float32)
        if found := taken(stillness, [frame]):
            held = found[0][1]
        fused.append(np.sqrt(np.mean((held - truth) ** 2)))
        single.append(np.sqrt(np.mean((frame - truth) ** 2)))
        seen += held
    assert max(fused) < 1.3 * max(single)
    assert np.mean(fused) < 1.05 * np.mean(single)


def test_recorded_decisions_give_the_same_means_and_where_frames_are_lacking_single_ones(stillness):
    rng = np.random.default_rng(6)
    frames = noise(rng, 400)
    frames[150:] += 0.01
    live, again = taken(stillness, frames), Stillness()
    decided = {number: count for number, _, count in live}
    means = {number: mean for number, mean, _ in live}

    def follow(numbers):
        for number in numbers:
            if again.follow(frames[number], decided.get(number, 1), keeps_map=number not in decided):
                yield number, again.mean.astype(float)

    assert all(np.array_equal(mean, means[number]) for number, mean in follow(range(400)))
    again.reset()
    for number, mean in follow(range(10, 400)):
        assert np.array_equal(mean, means[number] if number >= 127 else frames[number])


@pytest.fixture
def packer():
    packer = FramePacker(configuration="paper/1", bundle="b", serial_number="s", run="r", shape=PAPER.grid.shape)
    packer.put_texts("vd2t", (), ())
    return packer


def whole(packer, number, value):
    packer.put("n", number)
    packer.put("seq", number)
    packer.put("map_seq", number)
    packer.put_map(np.full(1350, value, "<f4").tobytes())
    return bytes(packer.message())


def short(packer, number, map_number):
    packer.put("n", number)
    packer.put("seq", number)
    packer.put("map_seq", map_number)
    return bytes(packer.short_message())


def test_a_short_message_means_the_map_of_the_frame_that_it_names(packer):
    known = unpack_frame(whole(packer, 3, 0.5), 0)
    frame = unpack_frame(short(packer, 4, 3), 0, known)
    assert frame.map is known.map
    assert (frame.sequence, frame.map_sequence) == (4, 3)
    again = unpack_frame(short(packer, 5, 3), 0, frame)
    assert again.map is known.map
    for missing in (None, unpack_frame(whole(packer, 2, 0.1), 0)):
        with pytest.raises(MapMissing, match="frame 5 has the map of frame 3"):
            unpack_frame(short(packer, 5, 3), 0, missing)
    assert issubclass(MapMissing, FrameError)


def test_short_frames_are_sent_only_while_every_subscriber_agrees(tmp_path):
    publisher = Publisher(f"ipc://{tmp_path}/frames")
    try:
        with eitskin.subscribe(publisher.endpoint, skip_unchanged=True):
            wait_for(publisher, lambda: publisher.takes_short)
            assert not publisher.short
            publisher.send(memoryview(b"a whole one"))
            assert publisher.short
            with eitskin.subscribe(publisher.endpoint, skip_unchanged=True):
                wait_for(publisher, lambda: publisher.joined)  # the newcomer has no map yet
                assert publisher.takes_short
                assert not publisher.short
            with eitskin.subscribe(publisher.endpoint):
                wait_for(publisher, lambda: not publisher.takes_short)
            wait_for(publisher, lambda: publisher.takes_short)
            with eitskin.subscribe(publisher.endpoint, region_mm=(0, 0, 10, 10)):
                wait_for(publisher, lambda: not publisher.takes_short)
        wait_for(publisher, lambda: not publisher.wanted)
    finally:
        publisher.close()


def test_a_resting_touch_is_computed_once_and_published_short(virtual_skin, running, tmp_path):
    options = {"touches": [[0.2, 60, 0.3]], "touches_wait": True, "noise": 1e-3}
    with virtual_skin(**options) as port, running(port, tmp_path, skip_unchanged=True) as runtime:
        with eitskin.subscribe(runtime.publisher.endpoint, mode="all", skip_unchanged=True, timeout_s=60) as frames:
            taken = [frame for frame, _ in zip(frames, range(150), strict=False)]
            assert frames.mapless == frames.lost == 0
        touched = [frame for frame in taken if frame.touched]
        reused = [frame for frame in touched if "inference:unchanged" in frame.skipped]
        assert len(reused) > 0.8 * len(touched) > 50
        assert all(frame.map.any() and frame.solver == "vd2t" for frame in touched)
        assert sum("map:unchanged" in frame.skipped for frame in reused) > 0.9 * len(reused)
        by_sequence = {frame.sequence: frame for frame in taken}
        for frame in reused:
            if frame.map_sequence in by_sequence:
                assert np.array_equal(frame.map, by_sequence[frame.map_sequence].map)
                assert frame.sequence - frame.map_sequence < REFRESH_FRAMES
        with eitskin.subscribe(runtime.publisher.endpoint, timeout_s=60) as plain:  # one who did not agree
            assert next(plain).map.any()
