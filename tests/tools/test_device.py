"""The virtual skin's state machine, against SPEC.md: it must speak the wire as the firmware does."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eitskin_proto import messages as m
from eitskin_proto.codes import Code, FrameFlag, HelloFlag, Mode
from eitskin_proto.config import Configuration
from eitskin_proto.errors import MismatchError
from eitskin_proto.framing import encode
from eitskin_proto.scan_rows import row_count, table_rows
from eitskin_tools.skin.configure import configuration_for
from eitskin_tools.skin.device import Identity, VirtualDevice

from .conftest import ROWS_V, Host, Ramp


def test_hello_repeats_the_tag_and_names_a_device_of_this_installation(host: Any) -> None:
    hello = host.ask(m.HelloRequest(7))
    assert isinstance(hello, m.Hello)
    hello.check()
    assert (hello.tag, hello.rows, hello.rate_mHz, hello.sample_bytes) == (7, 104, 200_000, 3)
    assert hello.flags == HelloFlag.FACTORY


def test_frames_carry_the_voltages_to_half_a_count(host: Any) -> None:
    hello = host.ask(m.HelloRequest(1))
    assert host.ask(m.Start(2)) == m.Ack(request=2, code=Code.OK, detail=0, tag=2)
    frame = host.sweep()
    expected = ROWS_V * 1.005  # the script's time counts from START: 5 ms
    assert np.abs(frame.counts * hello.volts_per_count - expected).max() <= 0.5001 * hello.volts_per_count
    assert frame.saturation == 0
    assert frame.flags == FrameFlag.FIRST
    assert host.sweep().flags == 0


def test_sequence_counts_scans_and_stop_keeps_it(host: Any) -> None:
    host.ask(m.Start(1))
    assert [host.sweep().sequence for _ in range(3)] == [0, 1, 2]
    host.ask(m.Stop(2))
    assert not host.device.streaming
    host.ask(m.Start(3))
    assert host.sweep().sequence == 3


def test_start_with_a_count_ends_by_itself(host: Any) -> None:
    host.ask(m.Start(1, frames=2))
    host.sweep()
    assert host.device.streaming
    host.sweep()
    assert not host.device.streaming


def test_the_device_clock_wraps_at_2_to_the_32() -> None:
    host = Host(VirtualDevice(Ramp(), configuration_for(200.0), 1_000_000_000, Identity(first_us=(1 << 32) - 7_000)))
    host.ask(m.Start(1))
    assert [host.sweep().device_us for _ in range(3)] == [(1 << 32) - 2_000, 3_000, 8_000]


def test_a_reset_starts_clock_and_sequence_anew_but_not_the_world(host: Any) -> None:
    host.ask(m.Start(1))
    host.sweep()
    host.device.boot(host.now_ns)
    assert not host.device.streaming
    host.ask(m.Start(2))
    frame = host.sweep()
    assert (frame.sequence, frame.device_us) == (0, 5_000)
    hello = host.ask(m.HelloRequest(3))
    assert np.allclose(frame.counts * hello.volts_per_count, ROWS_V * 1.010, atol=hello.volts_per_count)


def test_rows_beyond_full_scale_are_cut_off_and_marked(host: Any) -> None:
    host.ask(m.Start(1))
    (payload,) = host.deframer.feed(host.device.sweep(host.now_ns, overdriven_rows=3))
    frame = m.unpack(payload)
    assert frame.saturation == 0b111
    assert (frame.counts[:3] == (1 << 23) - 1).all()


@pytest.mark.parametrize("name", ["paper", "full208"])
def test_the_full_table_carries_every_row_and_its_reciprocal(name: str) -> None:
    host = Host(VirtualDevice(Ramp(), configuration_for(100.0, name), 1_000_000_000))
    hello = host.ask(m.HelloRequest(1))
    host.ask(m.Start(2))
    frame = host.sweep()
    rows = table_rows(hello.full, hello.drives)
    assert hello.rows == len(rows) == len(frame.counts)
    assert np.allclose(frame.counts * hello.volts_per_count, (ROWS_V * 1.005)[rows], atol=hello.volts_per_count)


def test_idle_mode_scans_the_subset_at_its_own_rate(host: Any) -> None:
    before = host.ask(m.HelloRequest(1))
    assert host.ask(m.SetMode(2, Mode.IDLE)).code == Code.OK
    idle = host.ask(m.HelloRequest(3))
    assert idle.flags & HelloFlag.IDLE
    assert idle.rate_mHz == host.device.store.configuration.idle_rate_millihertz < before.rate_mHz
    host.ask(m.Start(4))
    frame = host.sweep()
    assert frame.flags & FrameFlag.IDLE
    assert len(frame.counts) == row_count(False, before.idle_drives) < 104
    assert host.ask(m.SetMode(5, 9)).code == Code.BAD_VALUE


def test_doubtful_requests_are_answered_by_the_code_that_says_why(host: Any) -> None:
    assert host.send(encode(b"\x7f\x05"))[0] == m.Ack(request=0x7F, code=Code.UNKNOWN_TYPE, tag=5)
    assert host.send(encode(m.Start(6).pack() + b"\0"))[0].code == Code.BAD_LENGTH
    assert host.send(encode(m.HelloRequest(6).pack().replace(b"EITS", b"NOPE")))[0].code == Code.BAD_VALUE
    damaged = bytearray(encode(m.Start(7).pack()))
    damaged[2] ^= 0x10
    assert host.send(bytes(damaged)) == []
    assert not host.device.streaming


def test_a_foreign_device_is_recognised_by_its_hello() -> None:
    host = Host(VirtualDevice(Ramp(), configuration_for(200.0), 0, Identity(protocol_id="00000000f0e1d2c3")))
    with pytest.raises(MismatchError, match="00000000f0e1d2c3"):
        host.ask(m.HelloRequest(1)).check()


def test_a_rate_that_the_electronics_cannot_reach_is_refused_with_the_largest() -> None:
    assert configuration_for(1000.0).rate_hz == 1000.0
    with pytest.raises(ValueError, match=r"2272 Hz"):
        configuration_for(5000.0)


def flash(host: Any, configuration: Configuration, token: int = 9) -> m.Ack:
    """Begin, write and verify; return the answer to the first step that failed, or the last one."""
    blob = configuration.to_blob()
    answer = host.ask(
        m.ConfigBegin(
            token,
            len(blob),
            configuration.digest,
            configuration.hardware_id,
            configuration.revision,
            configuration.name,
            1,
        )
    )
    for at in range(0, len(blob), 32):
        if answer.code == Code.OK:
            answer = host.ask(m.ConfigWrite(token, at, blob[at : at + 32]))
    return host.ask(m.ConfigVerify(token)) if answer.code == Code.OK else answer


def test_a_flashed_configuration_runs_on_trial_and_stays_once_confirmed(host: Any) -> None:
    wanted = replace(configuration_for(100.0), revision=5)
    assert flash(host, wanted).detail == wanted.digest
    assert host.ask(m.ConfigCommit(9, wanted.digest)) == m.Ack(request=0x14, code=Code.OK, detail=1)
    assert host.ask(m.HelloRequest(1)).generation == 0
    host.ask(m.Restart(9))
    assert host.device.restart_due
    host.device.boot(host.now_ns)
    hello = host.ask(m.HelloRequest(1))
    assert (hello.generation, hello.configuration_digest, hello.rate_mHz) == (1, wanted.digest, 100_000)
    assert hello.flags == HelloFlag.TRIAL
    assert host.device.trial_ends_ns == host.now_ns + 30_000_000_000
    assert host.ask(m.ConfigConfirm(1, wanted.digest)).code == Code.OK
    assert host.device.trial_ends_ns == 0
    host.device.boot(host.now_ns)
    assert host.ask(m.HelloRequest(1)).generation == 1


def test_an_unconfirmed_configuration_is_given_up_at_the_next_boot(host: Any) -> None:
    wanted = replace(configuration_for(100.0), revision=5)
    flash(host, wanted)
    host.ask(m.ConfigCommit(9, wanted.digest))
    host.device.boot(host.now_ns)
    host.device.boot(host.now_ns)
    hello = host.ask(m.HelloRequest(1))
    assert hello.generation == 0
    assert hello.flags == HelloFlag.FACTORY | HelloFlag.ROLLED_BACK


def test_rollback_runs_the_slot_before(host: Any) -> None:
    for generation, rate in ((1, 100.0), (2, 50.0)):
        wanted = replace(configuration_for(rate), revision=generation + 1)
        flash(host, wanted)
        host.ask(m.ConfigCommit(9, wanted.digest))
        host.device.boot(host.now_ns)
        assert host.ask(m.ConfigConfirm(generation, wanted.digest)).code == Code.OK
    assert host.ask(m.ConfigRollback(9, 1)).code == Code.WRONG_GENERATION
    assert host.ask(m.ConfigRollback(9, 2)) == m.Ack(request=0x16, code=Code.OK, detail=1)
    assert host.ask(m.HelloRequest(1)).generation == 2
    host.device.boot(host.now_ns)
    assert host.ask(m.HelloRequest(1)).rate_mHz == 100_000
    assert host.ask(m.ConfigRollback(9, 1)).code == Code.NO_PREVIOUS


def test_two_sessions_exclude_each_other_until_ten_seconds_of_silence(host: Any) -> None:
    wanted = configuration_for(100.0)
    assert flash(host, wanted, token=1).code == Code.OK
    assert flash(host, wanted, token=2).code == Code.BUSY
    host.now_ns += 10_000_000_000
    assert flash(host, wanted, token=2).code == Code.OK
    assert host.ask(m.ConfigVerify(1)).code == Code.NO_SESSION
    assert host.ask(m.ConfigAbort(2)).code == Code.OK
    assert host.ask(m.ConfigRead(slot=1)).code == Code.NO_PREVIOUS


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"hardware_id": 1}, Code.WRONG_HARDWARE),
        ({"format": 9}, Code.BAD_FORMAT),
        ({"size": 80}, Code.TOO_LARGE),
        ({"size": 32}, Code.BAD_VALUE),
        ({"revision": 0}, Code.DOWNGRADE),
    ],
)
def test_a_configuration_that_cannot_run_is_refused_before_anything_is_erased(
    host: Any, change: dict, code: Code
) -> None:
    wanted = configuration_for(100.0)
    begin = m.ConfigBegin(9, 64, wanted.digest, wanted.hardware_id, wanted.revision, wanted.name, 1)
    assert host.ask(replace(begin, **change)).code == code
    assert host.ask(m.ConfigWrite(9, 0, bytes(4))).code == Code.NO_SESSION


def test_chunks_must_continue_and_what_arrived_must_be_what_was_announced(host: Any) -> None:
    wanted = configuration_for(100.0)
    begin = m.ConfigBegin(9, 64, wanted.digest, wanted.hardware_id, wanted.revision, wanted.name, 1)
    host.ask(begin)
    blob = wanted.to_blob()
    assert host.ask(m.ConfigWrite(9, 32, blob[32:])).code == Code.BAD_OFFSET
    assert host.ask(m.ConfigWrite(9, 0, blob[:3])).code == Code.BAD_VALUE
    assert host.ask(m.ConfigWrite(9, 0, blob[:32])).detail == 32
    assert host.ask(m.ConfigWrite(9, 0, blob[:32])).detail == 32, "a repeated chunk is no error: its answer was lost"
    assert host.ask(m.ConfigVerify(9)) == m.Ack(request=0x13, code=Code.INCOMPLETE, detail=32)
    assert host.ask(m.ConfigCommit(9, wanted.digest)).code == Code.INCOMPLETE
    host.ask(m.ConfigWrite(9, 32, blob[32:60] + bytes(4)))
    assert host.ask(m.ConfigVerify(9)).code == Code.INVALID_CONFIGURATION
    host.ask(replace(begin, digest=1))
    for at in (0, 32):
        host.ask(m.ConfigWrite(9, at, blob[at : at + 32]))
    assert host.ask(m.ConfigVerify(9)).code == Code.DIGEST_MISMATCH


def test_begin_is_refused_while_streaming(host: Any) -> None:
    host.ask(m.Start(1))
    assert flash(host, configuration_for(100.0)).code == Code.STREAMING


def test_a_configuration_is_read_in_pieces(host: Any) -> None:
    pieces = [host.ask(m.ConfigRead(1, 0, at, 32)) for at in (0, 32)]
    assert b"".join(piece.data for piece in pieces) == host.device.store.configuration.to_blob()
    assert host.ask(m.ConfigRead(1, 0, 0, 200)).code == Code.BAD_VALUE
