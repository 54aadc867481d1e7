"""The real firmware on an emulated Cortex-M3, over its pseudo-terminal."""

import numpy as np
import pytest
from tests.emulator.board import Board, record
from tests.emulator.firmware import missing_tools
from tests.emulator.patience import patient

from eitskin.acquisition.serial_port import SerialPort
from eitskin_proto.sensor.table import FULL_TABLE, ROW_IN_FULL
from eitskin_proto.wire import framing, messages
from eitskin_proto.wire.codes import HelloFlag
from eitskin_proto.wire.frames import Frame

MISSING = missing_tools("qemu")
SILENCE_S = 60.0
"""A board that sends nothing for so long is gone; on a busy machine it is slow."""

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(
        bool(MISSING),
        reason=f"{', '.join(MISSING)} not found: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi "
        "qemu-system-arm",
    ),
]


def frames_of(port, count):
    deframer, frames = framing.Deframer(), []
    while len(frames) < count and (data := port.read(SILENCE_S)):
        for payload in deframer.feed(data):
            message = messages.unpack(payload)
            if isinstance(message, Frame):
                frames.append(message)
    return frames, deframer


@pytest.fixture
def storage(tmp_path):
    return tmp_path / "storage.bin"


def test_it_shakes_hands_streams_and_plays_its_pattern(storage):
    with Board(storage) as board:
        port = SerialPort(board.port)
        try:
            exchange = patient(port)
            hello = exchange.hello()
            assert (hello.serial_number, hello.flags, hello.rows) == ("QEMU-AN385", HelloFlag.FACTORY, 104)
            exchange.command(messages.Start)
            frames, deframer = frames_of(port, 60)
        finally:
            port.close()
    assert len(frames) >= 60
    assert deframer.corrupt == 0
    lost = frames[-1].sequence + 1 - len(frames) - frames[0].sequence
    # The reader began a little after the first frames left; what the board itself could not send, it counted.
    assert lost <= frames[-1].device_dropped
    drive_and_pair = FULL_TABLE[ROW_IN_FULL].astype(int)
    base = ((drive_and_pair[:, 0] * 16 + drive_and_pair[:, 1] + 1) << 16) * 8  # gain 8
    step = (frames[5].counts.astype(int) * 256 - base) / (256 * 8)
    assert np.ptp(step) == 0, "every row of a frame comes from the same scan"


def test_a_recording_comes_out_as_the_volts_that_went_in(storage):
    rng = np.random.default_rng(0)
    volts = rng.normal(size=(4, 208)) * np.logspace(-3, 0, 208)
    with Board(storage):
        pass
    record(storage, volts, gain=8)
    with Board(storage) as board:
        port = SerialPort(board.port)
        try:
            exchange = patient(port)
            scale = exchange.hello().volts_per_count
            exchange.command(messages.Start)
            frames, _ = frames_of(port, 8)
        finally:
            port.close()
    # 24 bit: half a step of rounding, and half a step of the 32-bit recording times the gain.
    for frame in frames:
        error = np.abs(frame.counts * scale - volts[:, ROW_IN_FULL]).max(axis=1).min()
        assert error <= 0.6 * scale
    assert scale == pytest.approx(np.abs(volts).max() * 2**-22, rel=1e-12)


def test_a_recording_that_does_not_fit_is_refused(storage):
    with pytest.raises(ValueError, match=r"shape \(3, 104\), expected \(1 to \d+, 208\)"):
        record(storage, np.ones((3, 104)))
    with pytest.raises(ValueError, match=r"largest voltage is 0\.0"):
        record(storage, np.zeros((3, 208)))
