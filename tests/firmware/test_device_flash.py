"""The whole C device in memory: flashing, trials, locks, and lines that lose what it says."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.sensor.table import FULL_TABLE
from eitskin_proto.wire import config_toml, messages
from eitskin_proto.wire.codes import Code, FrameFlag, HelloFlag
from eitskin_proto.wire.frames import Frame
from eitskin_tools.flash import procedure
from eitskin_tools.flash.exchange import Exchange, Refused, Silent

from .talk import FAST, PAPER, ack, begin, talk


def test_a_configuration_is_written_read_back_tried_and_confirmed(device):
    exchange, steps = Exchange(device), []
    stored = procedure.write(exchange, FAST, progress=steps.append)
    assert stored == procedure.Stored(FAST, 1)
    assert steps == ["begin", "write", "verify", "commit", "restart", "boot", "confirm", "done"]
    shown = procedure.show(exchange)
    assert shown.active == stored
    assert shown.hello.flags == 0
    device.boot()
    assert procedure.show(exchange).active == stored


def test_streams_carry_the_generation_and_the_full_table_after_a_change(device):
    exchange = Exchange(device)
    procedure.write(exchange, FAST)
    procedure.write(exchange, config_toml.named("full208"))
    counts = np.arange(256, dtype=np.int32).reshape(16, 16) << 16
    device.set_counts(counts, np.zeros(16, dtype=np.uint16))
    frames = [m for m in talk(device, messages.Start(), run_us=100_000) if isinstance(m, Frame)]
    assert {frame.generation for frame in frames} == {2}
    assert frames[0].flags & FrameFlag.FULL
    assert frames[0].counts.tolist() == [int(counts[k, m]) >> 8 for k, m in FULL_TABLE]


def test_without_a_confirmation_the_next_boot_goes_back(device):
    exchange = Exchange(device)
    procedure.write(exchange, PAPER)
    blob = FAST.to_blob()
    for request in (begin(), messages.ConfigWrite(5, 0, blob[:32]), messages.ConfigWrite(5, 32, blob[32:]),
                    messages.ConfigCommit(5, FAST.digest), messages.Restart(5)):  # fmt: skip
        assert ack(device, request).code == Code.OK
    device.run(30_000)
    tried = exchange.hello()
    assert (tried.configuration_name, tried.flags) == ("fast", HelloFlag.TRIAL)
    frames = [m for m in talk(device, messages.Start(frames=1), run_us=9000) if isinstance(m, Frame)]
    assert frames[0].flags & FrameFlag.TRIAL
    device.boot()
    back = exchange.hello()
    assert (back.configuration_name, back.generation, back.flags) == ("paper", 1, HelloFlag.ROLLED_BACK)


def test_rolling_back_returns_to_the_configuration_before(device):
    exchange = Exchange(device)
    with pytest.raises(procedure.FlashError, match="no earlier configuration"):
        procedure.rollback(exchange)
    procedure.write(exchange, FAST)
    procedure.write(exchange, PAPER)
    assert procedure.rollback(exchange).configuration_name == "fast"
    with pytest.raises(procedure.FlashError, match="no earlier configuration"):
        procedure.rollback(exchange)  # the revoked one is no place to return to
    assert procedure.write(exchange, PAPER).generation == 3  # a number is not given twice


def test_a_lock_that_expired_stays_so_when_the_clock_has_come_round(device):
    assert ack(device, begin(token=5)).code == Code.OK
    for _ in range(43):  # 2^32 us are 71.6 minutes
        device.run(100_000_000, step_us=1_000_000)
    assert ack(device, begin(token=6)).code == Code.OK


class Faulty:
    """A line that loses, repeats or holds back what the device says, by a script."""

    def __init__(self, device, script):
        self.device, self.script, self.name = device, iter(script), "a faulty line"
        self.held = b""

    def read(self, timeout_s=None):
        data = self.device.read(timeout_s)
        if not data:
            return data
        fate = next(self.script, "pass")
        if fate == "late":  # comes with whatever the device says next, long after it was asked again
            self.held = data
            return b""
        data, self.held = self.held + data, b""
        if fate == "lose":
            return self.device.read(timeout_s)
        return data * 2 if fate == "twice" else data

    def __getattr__(self, name):
        return getattr(self.device, name)


@pytest.mark.parametrize("fate", ["lose", "twice", "late"])
@pytest.mark.parametrize("when", range(14))
def test_an_answer_that_is_lost_or_late_or_comes_twice_changes_nothing(device, fate, when):
    exchange = Exchange(Faulty(device, ["pass"] * when + [fate]), timeout_s=0.05)
    assert procedure.write(exchange, FAST).generation == 1
    assert procedure.show(exchange).active.configuration == FAST


def test_a_device_that_never_answers_is_named(device):
    device.cut_line = True
    with pytest.raises(Silent, match="host model of the device did not answer HELLO_REQUEST in 4 attempts: is it an"):
        procedure.show(Exchange(device, timeout_s=0.01))


def test_the_host_refuses_what_the_line_cannot_carry_before_it_writes(device):
    before = device.changes
    with pytest.raises(ValueError, match=r"rate_Hz is 400\.0, but a line of 92160 bytes/s reaches at most 354"):
        procedure.write(Exchange(device), replace(FAST, rate_mHz=400_000))
    with pytest.raises(procedure.FlashError, match=r"'fast' is for 0x00000063, the device is eitskin-16: nothing was"):
        procedure.write(Exchange(device), replace(FAST, hardware_id=99))
    with pytest.raises(Refused, match=r"refused CONFIG_BEGIN: DOWNGRADE: .*detail 1"):
        procedure.write(Exchange(device), replace(PAPER, revision=0))
    assert device.changes == before


def test_differences_name_the_fields(device):
    exchange = Exchange(device)
    assert procedure.verify(exchange, PAPER) == []
    assert procedure.verify(exchange, replace(PAPER, gain=4, settle_us=90)) == [("settle_us", 100, 90), ("gain", 8, 4)]
