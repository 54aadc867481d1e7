"""Flashing when something else goes on: two flashers, a port in use, a device that answers late, twice or never."""

import itertools
import time
from contextlib import contextmanager

import numpy as np
import pytest

from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import PortBusy
from eitskin_proto.wire import config_toml, framing, messages
from eitskin_proto.wire.codes import Code
from eitskin_tools import cli
from eitskin_tools.flash import procedure
from eitskin_tools.flash.exchange import Exchange, Refused, Silent
from eitskin_tools.virtual_skin.device import VirtualDevice
from eitskin_tools.virtual_skin.faults import FaultPlayer, parse
from eitskin_tools.virtual_skin.process import configuration_for

from .conftest import served

FAST, FULL = config_toml.named("fast"), config_toml.named("full208")


def test_a_second_flasher_is_refused_at_every_step_and_the_first_one_is_not_disturbed(device):
    refusals = []

    def intrude(step, done, total):
        if step in ("begin", "restart", "boot", "done"):
            return  # before the lock is taken, and while the device is busy with itself
        before = device.changes
        with pytest.raises(Refused) as raised:
            procedure.write(Exchange(device), FULL)
        assert device.changes == before, f"{step}: nothing was written"
        refusals.append((step, raised.value.ack.code))
        assert "the device refused CONFIG_BEGIN" in str(raised.value)

    assert procedure.write(Exchange(device), FAST, progress=intrude).generation == 1
    # On trial the lock is gone with the restart; the configuration must be confirmed before another is begun.
    assert refusals == [("write", Code.BUSY), ("write", Code.BUSY), ("verify", Code.BUSY), ("commit", Code.BUSY),
                        ("confirm", Code.NOT_CONFIRMED)]  # fmt: skip
    assert procedure.show(Exchange(device)).active.configuration == FAST
    assert procedure.write(Exchange(device), FULL).generation == 2, "and then it is the second one's turn"


def test_a_flasher_that_dies_blocks_the_others_for_ten_seconds_only(device):
    class Killed(Exception):
        pass

    def die(step, done, total):
        if step == "verify":
            raise Killed

    with pytest.raises(Killed):
        procedure.write(Exchange(device), FAST, progress=die)
    with pytest.raises(Refused, match=r"BUSY: another session .* its lock expires after 10 s of silence"):
        procedure.write(Exchange(device), FULL)
    device.run(10_000_000, step_us=10_000)
    assert procedure.write(Exchange(device), FULL).generation == 1


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


def test_a_device_that_falls_silent_in_the_middle_keeps_its_old_configuration(monkeypatch):
    for when in range(1, 7):
        with skin() as (made, port):
            line = SerialPort(port)
            exchange = Exchange(line, timeout_s=0.03, attempts=2)
            count = itertools.count(1)
            answer = made.receive

            def silent_from(data, now_ns, answer=answer, count=count, when=when):
                packets = answer(data, now_ns) if data.strip(b"\0") else []
                return packets if not packets or next(count) <= when else []

            monkeypatch.setattr(made, "receive", silent_from)
            with pytest.raises((procedure.FlashError, Silent), match=r"did not answer|keeps its old"):
                procedure.write(exchange, FAST)
            monkeypatch.undo()
            line.close()
            made.boot(time.perf_counter_ns())
            assert made.store.generation == 0, f"silent after {when} answers"
