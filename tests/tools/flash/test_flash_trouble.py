"""Flashing when something else goes on: two flashers, a port in use, a device that answers late, twice or never."""

import time
from contextlib import contextmanager

import numpy as np
import pytest

from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import PortBusy
from eitskin_proto.wire import framing, messages
from eitskin_tools import cli
from eitskin_tools.virtual_skin.device import VirtualDevice
from eitskin_tools.virtual_skin.faults import FaultPlayer, parse
from eitskin_tools.virtual_skin.process import configuration_for

from .conftest import served


class Steady:
    def voltages(self, time_s):
        return np.linspace(-0.1, -0.001, 104)


@contextmanager
def skin(*faults):
    """Serve a virtual skin on a pseudo-terminal in a thread."""
    made = VirtualDevice(Steady(), configuration_for(200.0), time.perf_counter_ns())
    with served(made, FaultPlayer([parse(text) for text in faults])) as path:
        yield made, path


@pytest.mark.process
def test_a_port_that_another_program_streams_from_is_left_alone(capsys):
    with skin() as (made, port):
        first = SerialPort(port)
        first.write(framing.encode(messages.Start().pack()))
        assert first.read(60.0)  # it streams
        assert cli.main(["flash", "write", "fast", "--port", port]) == 1
        err = capsys.readouterr().err.splitlines()
        assert len(err) == 1
        assert "is open in another program" in err[0]
        with pytest.raises(PortBusy):
            SerialPort(port)
        assert made.streaming
        assert made.store.generation == 0
        first.close()


def test_a_device_that_never_answers_is_one_line_and_stays_as_it_was(capsys):
    with skin("mute@0:60") as (made, port):
        assert cli.main(["flash", "write", "fast", "--port", port]) == 1
        err = capsys.readouterr().err.splitlines()
        assert len(err) == 1
        assert "did not answer HELLO_REQUEST in 4 attempts" in err[0]
        assert made.store.generation == 0
