"""A recording behind a line: the runtime greets it as it greets a device, and reads what was recorded."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eitskin
from eitskin import Frame
from eitskin.acquisition.device import Device
from eitskin_proto.wire.frames import HEADER
from eitskin_tools.recording.replay import RecordedLine

from .conftest import TINY, Taker, hello, play, reference, scans


def test_it_answers_the_handshake_and_sends_what_was_recorded_in_order() -> None:
    steps = scans(20)
    line = RecordedLine("it", hello(), lambda: iter(steps), paced=False)
    device = Device(line)
    assert device.hello.serial_number == "TEST-1"
    device.start()
    found = [payload for _ in steps for payload in device.payloads(1.0)]
    assert found == [step.frame.payload for step in steps]
    assert device.time_sample is not None
    assert device.time_sample.device_us == HEADER.unpack_from(found[0])[6]


def test_what_belongs_before_a_frame_is_done_when_the_one_before_it_was_taken() -> None:
    steps = scans(5)
    line = RecordedLine("it", hello(), lambda: iter(steps), paced=False)
    done: list[Any] = []
    line.before = lambda step: done.append(step.frame.seq)
    device = Device(line)
    device.start()
    for number in range(5):
        device.payloads(1.0)
        assert done == [100, 101, 102, 103, 104][: number + 1]


def test_a_gap_of_the_recording_is_no_silence_of_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eitskin.acquisition.device.SILENCE_S", 0.1)  # ten times in the gap
    steps = scans(20)
    steps[10:] = [replace(step, log_ns=step.log_ns + 1_000_000_000) for step in steps[10:]]
    line = RecordedLine("it", replace(hello(), rate_mHz=2_000_000), lambda: iter(steps))
    with eitskin.Skin(line, bundle=TINY, reference=reference()) as skin:
        line.ended = skin.stop
        assert sum(1 for _ in skin.publish(Taker())) == 20
        assert skin.status()["recoveries"] == 0


def test_again_and_again_the_numbers_go_on() -> None:
    steps = scans(7)
    line = RecordedLine("it", hello(), lambda: iter(steps), paced=False, loop=True)
    device = Device(line)
    device.start()
    heads = [HEADER.unpack_from(payload) for _ in range(21) for payload in device.payloads(1.0)]
    assert [head[5] for head in heads] == list(range(100, 121))
    assert set(np.diff([head[6] for head in heads])) == {5000}
    assert line.rounds == 2


def test_a_read_that_waits_is_woken_by_cancel() -> None:
    line = RecordedLine("it", hello(), lambda: iter(()), paced=True)
    found: list[bytes] = []
    thread = threading.Thread(target=lambda: found.append(line.read(None)))
    thread.start()
    line.cancel()
    thread.join(30)
    assert found == [b""]


def test_a_program_sees_what_it_saw_then(file: Path, items: list[Any]) -> None:
    again = [item for item in play(file) if isinstance(item, Frame)]
    then = [item for item in items if isinstance(item, Frame)]
    assert len(again) == len(then)
    for one, other in zip(again, then, strict=True):
        assert (one.sequence, one.device_us, one.touched, one.cloud) == (
            other.sequence, other.device_us, other.touched, other.cloud,
        )  # fmt: skip
        assert one.map.tobytes() == other.map.tobytes()
        assert one.serial_number == other.serial_number
    assert [one.events for one in again] == [one.events for one in then]
