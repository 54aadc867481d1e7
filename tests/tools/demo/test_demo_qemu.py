"""The emulated board as the demonstration's skin: the same voltages, the same log, nothing left behind."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from tests.emulator.emulated_skin import recording
from tests.emulator.firmware import FOLDER, missing_tools

from eitskin.acquisition.device import Device
from eitskin.acquisition.serial_port import SerialPort
from eitskin_proto.errors import SkinError
from eitskin_proto.sensor.table import ROW_IN_FULL
from eitskin_proto.wire.codes import MessageType
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.scan_rows import table_rows
from eitskin_tools.demo import show
from eitskin_tools.processes.skin_log import read_log, script_start

MISSING = missing_tools("qemu")


def test_a_recording_repeats_the_scripts_period_with_equal_reciprocal_rows():
    volts = recording(20.0, None, "none", 0)
    assert volts.shape[1] == 208
    assert 100 < len(volts) <= 1200
    rows = table_rows(True, 0xFFFF)
    for row in range(104):
        first, second = np.flatnonzero(rows == row)
        assert np.array_equal(volts[:, first], volts[:, second])
    assert np.ptp(volts, axis=0).max() > 0, "touches come and go"


@pytest.mark.process
@pytest.mark.skipif(bool(MISSING), reason=f"{', '.join(MISSING)} not found: apt-get install qemu-system-arm ...")
def test_the_firmware_streams_the_scripts_voltages_and_its_log_says_when(tmp_path):
    log, wire = tmp_path / "skin.log", tmp_path / "wire.npy"
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.emulator.emulated_skin", "--rate=100", "--noise=none", f"--log={log}",
         f"--wire-times={wire}", "--seconds=900"],
        stdout=subprocess.PIPE, text=True, cwd=FOLDER.parent,
    )  # fmt: skip
    try:
        port = SerialPort(json.loads(process.stdout.readline())["port"])
        device, view = Device(port), FrameView()
        assert device.hello.serial_number == "QEMU-AN385"
        assert device.hello.rate_mHz == 100_000, "the board was flashed for this rate"
        device.start()
        first, volts = None, np.zeros(104)
        while first is None:
            for payload in device.payloads(60.0):
                if payload[0] == MessageType.FRAME and first is None:
                    view.load(payload)
                    volts = view.counts * device.hello.volts_per_count
                    first = view.sequence
        port.close()
        assert script_start(log)["device_us"] > 0
        assert np.load(wire, mmap_mode="r")[first] > 0
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(120.0) == 0
        process.stdout.close()
    last = read_log(log)[-1]
    assert last["event"] == "stop"
    sequences = np.flatnonzero(np.load(wire))  # every number that passed, by itself: what is missing, the board counted
    assert sequences[-1] + 1 - sequences[0] - len(sequences) == last["dropped"]
    assert len(sequences) == last["sent"]
    flat = recording(100.0, None, "none", 0)[0, ROW_IN_FULL]
    # Half a step of 24 bit, and half a step of the recording.
    assert np.abs(volts - flat).max() <= 0.6 * device.hello.volts_per_count


def test_a_wheel_without_the_emulated_board_says_so_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(show, "__file__", str(tmp_path / "a" / "b" / "c" / "show.py"))
    with pytest.raises(SkinError, match="--device qemu needs a source checkout"):
        show.checkout()
