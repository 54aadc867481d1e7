"""All 208 rows for a while, and back: on the C core in memory and on the virtual skin's pseudo-terminal."""

import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from eitskin.acquisition.device import Device
from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import SkinError, TransportError
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS
from eitskin_proto.wire import config_toml
from eitskin_tools.flash.exchange import Exchange
from eitskin_tools.flash.full_scan import full_scan, scanning_all_rows
from eitskin_tools.flash.procedure import FlashError
from eitskin_tools.guided import frames_of
from eitskin_tools.virtual_skin.device import VirtualDevice
from eitskin_tools.virtual_skin.process import configuration_for

from .conftest import served

PAPER, FAST = config_toml.named("paper"), config_toml.named("fast")
VOLTS = -0.1 * np.random.default_rng(1).uniform(0.01, 1.0, N_FULL_ROWS)
"""A front end that reads a pair of pairs otherwise the other way round."""


class Full:
    def __init__(self, volts=VOLTS):
        self.volts = volts

    def voltages(self, time_s):
        return self.volts.copy()


@contextmanager
def skin(volts=VOLTS):
    """Serve a virtual skin on a pseudo-terminal in a thread."""
    made = VirtualDevice(Full(volts), configuration_for(200.0), time.perf_counter_ns())
    with served(made) as path:
        yield made, path


@pytest.mark.parametrize("own", [PAPER, FAST, replace(PAPER, name="ours", skin="0123456789abcdef", revision=7)])
def test_all_rows_are_scanned_with_the_same_front_end_as_fast_as_line_and_electronics_allow(own):
    for line in (0, 92_160, 11_520):
        full = full_scan(own, line)
        full.check(line)
        assert full.frame_rows == N_FULL_ROWS
        assert full.rate_mHz <= own.rate_mHz
        if full.rate_mHz < own.rate_mHz:
            with pytest.raises(ValueError, match="rate_Hz"):
                replace(full, rate_mHz=full.rate_mHz + 20).check(line)
        for name in ("frequency_hz", "current_ua", "settle_us", "averages", "gain", "sample_bytes", "skin"):
            assert getattr(full, name) == getattr(own, name), name


@pytest.mark.parametrize("error", [SkinError("nobody presses"), KeyboardInterrupt(), OSError("disk full")])
def test_whatever_ends_the_work_the_device_goes_back(device, error):
    digest = Exchange(device).hello().configuration_digest
    with pytest.raises(type(error)), scanning_all_rows(lambda: device, lambda _: None):
        raise error
    assert Exchange(device).hello().configuration_digest == digest


def test_what_cannot_go_back_is_said_with_the_remedy_and_the_next_calibration_brings_it_back(device):
    lines = iter([device])

    def gone_later():
        for line in lines:
            return line
        raise TransportError("/dev/ttyACM0 is gone")

    remedy = r"recording stopped; the device still scans 208 rows \(.*is gone\); .*'eitskin flash rollback'"
    with pytest.raises(FlashError, match=remedy), scanning_all_rows(gone_later, lambda _: None):
        raise SkinError("recording stopped")
    assert Exchange(device).hello().rows == N_FULL_ROWS
    told = []
    with scanning_all_rows(lambda: device, told.append):
        assert Exchange(device).hello().rows == N_FULL_ROWS
    assert "since a calibration that ended early" in told[0]
    assert Exchange(device).hello().rows == N_ROWS


@pytest.mark.process
def test_a_guided_recording_gets_both_readings_of_every_pair_of_pairs():
    with skin() as (made, port):
        with scanning_all_rows(lambda: SerialPort(port), lambda _: None):
            line = SerialPort(port)
            try:
                device = Device(line)
                device.start()
                volts = next(frames_of(device))
                device.stop()
            finally:
                line.close()
        assert made.store.configuration.digest == configuration_for(200.0).digest
    assert volts.shape == (N_FULL_ROWS,)
    assert np.allclose(volts, VOLTS, atol=1e-6)
