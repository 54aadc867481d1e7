"""A whole skin, with the faults that lines, cables and devices have."""

import os
import sys
import termios
import threading
import time
from fcntl import ioctl

import numpy as np
import pytest

from eitskin.acquisition import device as devices
from eitskin.errors import BadReference, PortLost
from eitskin.skin import Skin

from .made_up_skin import begin_touches


def opened(port, tiny_path, **options):
    skin = Skin(port, bundle=tiny_path, **options)
    skin.capture_reference(10)
    begin_touches(port)
    return skin


def wait_for_bytes(port, wanted):
    """Wait until so many bytes wait in the line of a port, at most a minute."""
    line = os.open(port, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        waiting, until = 0, time.monotonic() + 60.0
        while waiting < wanted and time.monotonic() < until:
            waiting = int.from_bytes(ioctl(line, termios.FIONREAD, bytes(4)), sys.byteorder)
            time.sleep(0.02)
    finally:
        os.close(line)
    assert waiting >= wanted


def collect(skin, seconds):
    """Return the frames of so many seconds on the device's clock, however long a busy machine takes for them."""
    frames, passed_us = [], 0
    for frame in skin.frames(timeout_s=120.0):
        if frames:
            passed_us += max(0, frame.device_us - frames[-1].device_us)  # a reset sets the clock back
        frames.append(frame)
        if passed_us >= 1e6 * seconds:
            break
    return frames


def test_touches_come_and_go_and_untouched_frames_are_not_computed(virtual_skin, tiny_path):
    with virtual_skin() as port, opened(port, tiny_path) as skin:
        untouched = skin.reference
    pressed = [[second + 0.6, second + 1.0, 0.3] for second in range(300)]  # whenever a busy machine comes to it
    with virtual_skin(touches=pressed) as port, Skin(port, bundle=tiny_path, reference=untouched) as skin:
        frames = collect(skin, 1.2)
    touched = [frame for frame in frames if frame.touched]
    untouched = [frame for frame in frames if not frame.touched]
    assert 20 < len(touched) < 60
    assert all(frame.solver == "vd2t" and frame.map.any() for frame in touched)
    assert all(frame.solver == "none" and not frame.map.any() for frame in untouched)
    assert all("inference:untouched" in frame.skipped for frame in untouched)
    assert len({frame.sequence for frame in frames}) == len(frames)
    assert frames[-1].counts == {"lost": 0, "corrupt": 0, "withheld": frames[0].counts["withheld"], "overrun": 0}


def test_the_first_frame_is_not_one_that_waited_since_before_anybody_asked(virtual_skin, tiny_path):
    with virtual_skin() as port, opened(port, tiny_path) as skin:
        last, stale = skin.pipeline.record.sequence, skin.pipeline.intake.withheld["stale"]
        wait_for_bytes(port, 4095)  # all that the kernel counts of a pseudo-terminal: eleven frames, and more behind
        first = next(skin.frames())
        assert first.sequence > last + 10
        assert skin.pipeline.intake.withheld["stale"] - stale == first.sequence - last - 1
        assert skin.pipeline.intake.withheld["stale"] == first.counts["withheld"]
        assert first.counts["lost"] == 0


@pytest.mark.parametrize("fault", ["flip@0.3/0.05:1", "drop@0.3/0.05:10"])
def test_damage_is_dropped_and_counted_and_nothing_is_shifted(virtual_skin, tiny_path, fault):
    # The reference's 10 frames take 0.1 s; the damage begins after them
    with virtual_skin(faults=[fault]) as port, opened(port, tiny_path) as skin:
        frames = collect(skin, 0.9)
        corrupt, lost = skin.device.deframer.corrupt, skin.pipeline.counter.lost
    assert 8 <= lost <= 2 * corrupt
    assert len(frames) > 30
    # Untouched frames differ from the reference by noise of 1e-4; one shifted byte would change dV by far more
    assert all(not frame.touched and frame.gate_logit < 1e-3 for frame in frames)
    steps = np.diff([frame.sequence for frame in frames])
    assert steps.sum() - len(steps) == frames[-1].counts["lost"] - frames[0].counts["lost"]
    assert (steps > 1).tolist() == ["lost" in frame.events for frame in frames[1:]]


def test_counters_that_wrap_lose_nothing(virtual_skin, tiny_path):
    frames = []
    with virtual_skin(sequence=2**32 - 60, first_us=2**32 - 2_000_000) as port, opened(port, tiny_path) as skin:
        for frame in skin.frames(timeout_s=120.0):
            frames.append(frame)
            if frame.device_us > 2**32 + 100_000 and frame.sequence > 2**32 + 10:
                break
        assert skin.pipeline.counter.resets == 0
        # A starved machine may lose a few frames for real; a wrap taken for a gap would be billions.
        assert skin.pipeline.counter.lost < 1000
    sequences = [frame.sequence for frame in frames]
    assert sequences[0] < 2**32 < sequences[-1]
    assert 0 < min(np.diff(sequences)) <= max(np.diff(sequences)) < 1000
    times_us = [frame.device_us for frame in frames]
    assert np.all(np.diff(times_us) == 10_000 * np.diff(sequences))
    assert times_us[-1] > 2**32


def test_a_reset_in_the_middle_of_a_sweep_is_noticed_and_streaming_resumes(virtual_skin, tiny_path, monkeypatch):
    monkeypatch.setattr(devices, "SILENCE_S", 0.2)
    with virtual_skin(faults=["reset@0.5"]) as port, opened(port, tiny_path) as skin:
        frames = collect(skin, 1.5)
        assert skin.recoveries == 1
        assert skin.pipeline.counter.resets == 1
    events = [frame.events for frame in frames if frame.events]
    assert ("recovered", "device_reset") in events
    after = frames[[frame.events for frame in frames].index(("recovered", "device_reset")) :]
    assert after[0].sequence < frames[0].sequence
    assert len(after) > 10
    assert not any(frame.touched for frame in frames)


def test_a_port_that_is_unplugged_is_lost_in_one_line(virtual_skin, tiny_path):
    with (
        virtual_skin(faults=["unplug@0.4:99"]) as port,
        opened(port, tiny_path) as skin,
        pytest.raises(PortLost, match=r"vanished[^\n]*$"),
    ):
        collect(skin, 3.0)


def test_saturated_rows_are_an_event_of_their_frame(virtual_skin, tiny_path):
    with virtual_skin(faults=["saturate@0.3:5"]) as port, opened(port, tiny_path) as skin:
        frames = collect(skin, 0.6)
    assert sum("saturated" in frame.events for frame in frames) == 1


def test_frames_without_a_reference_say_what_to_do(virtual_skin, tiny_path):
    with (
        virtual_skin() as port,
        Skin(port, bundle=tiny_path) as skin,
        pytest.raises(BadReference, match="capture_reference"),
    ):
        next(skin.frames())


def test_a_cloud_set_between_frames_shows_in_the_next_and_costs_the_others_nothing(virtual_skin, tiny_path):
    from eitskin_proto.skin.cloud import flat_cloud

    with virtual_skin(touches=[[0.15, 9, 0.3]], touches_wait=True) as port, opened(port, tiny_path) as skin:
        frames = []
        cloud = flat_cloud()
        cloud[2] = 0.005 * (cloud[0] - 75) ** 2 - 10 * np.exp(-(np.hypot(cloud[0] - 60, cloud[1] - 50) ** 2) / 288)
        for frame in skin.frames(timeout_s=120.0):
            frames.append(frame)
            if len(frames) == 20:
                assert skin.set_cloud(cloud) == 1
            if len(frames) == 40:
                break
    assert [frame.cloud for frame in frames] == [0] * 20 + [1] * 20
    assert [index for index, frame in enumerate(frames) if "cloud" in frame.events] == [20]
    assert "cloud:unlike_training:dent" in frames[20].events
    assert all("geometry:cloud_unchanged" in frame.skipped for index, frame in enumerate(frames) if index != 20)
    late = np.mean([frame.map for frame in frames[21:]], axis=0)
    early = np.mean([frame.map for frame in frames[12:20]], axis=0)
    assert np.abs(late - early).max() > 1e-3


def test_stopping_from_another_thread_ends_the_frames(virtual_skin, tiny_path):

    with virtual_skin() as port, opened(port, tiny_path) as skin:
        threading.Timer(0.3, skin.stop).start()
        start = time.perf_counter()
        assert list(skin.frames())
        assert time.perf_counter() - start < 60.0


@pytest.mark.parametrize(("kind", "reason"), [("stuck", "stuck"), ("failing", "lost")])
def test_of_a_front_end_that_hangs_nothing_is_published_and_the_next_frame_says_so(
    virtual_skin, tiny_path, kind, reason
):
    with virtual_skin(faults=[f"{kind}@0.6:0.4"], noise=3e-3) as port, opened(port, tiny_path) as skin:
        frames = collect(skin, 1.6)
        withheld = skin.pipeline.intake.withheld
    before = next(index for index, frame in enumerate(frames) if {f"withheld:{reason}", reason} & set(frame.events))
    assert frames[before].device_us - frames[before - 1].device_us >= 350_000
    assert not any(frame.touched for frame in frames)
    missing = frames[before].sequence - frames[before - 1].sequence - 1
    lost = frames[before].counts["lost"] - frames[before - 1].counts["lost"]
    # What is stuck at one count repeats as well; a busy machine's skin skips scans
    assert kind == "failing" or withheld["stuck"] + withheld["frozen"] == missing - lost > 0
    assert skin.recoveries == 0


def until(found, skin):
    """Yield now and then until there is trouble, or for a minute, and then stop the skin."""
    end = time.monotonic() + 60.0
    while "stuck" not in found and time.monotonic() < end:
        time.sleep(0.01)
        yield
    skin.stop()
