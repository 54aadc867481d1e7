"""One set of questions for every device that speaks the wire: the C core, the virtual skin, and the emulated board.

What SPEC.md says is asked here once; what only one of them has (faults, storage that tears) is tested beside it.
"""

import os
from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.wire import framing
from eitskin_proto.wire import messages as m
from eitskin_proto.wire.codes import Code, FrameFlag, HelloFlag, Mode
from eitskin_proto.wire.frames import Frame

from .asked import FAST, FULL, PAPER, CoreAsked, VirtualAsked, begin


def test_hello_names_the_running_configuration(asked):
    hello = asked.ask(m.HelloRequest(tag=200))
    hello.check()
    assert (hello.generation, hello.configuration_digest, hello.configuration_name) == (0, PAPER.digest, "paper")
    assert (hello.rows, hello.sample_bytes, hello.rate_mHz, hello.drives) == (104, 3, 200_000, 0xFFFF)
    assert hello.idle_drives == PAPER.idle_drives
    assert hello.max_payload >= m.ConfigWrite.LAYOUT.size + m.CHUNK_BYTES
    assert hello.flags == HelloFlag.FACTORY


def test_bad_requests_are_answered_with_the_code_and_their_length(asked):
    cases = ((b"\x7f\x05", Code.UNKNOWN_TYPE), (b"\x80\x05zz", Code.UNKNOWN_TYPE), (b"\x02\x05", Code.BAD_LENGTH),
             (m.Stop(5).pack() + b"\0", Code.BAD_LENGTH), (b"\x01\x05EITX\x01\x00", Code.BAD_VALUE))  # fmt: skip
    for payload, code in cases:
        answers = [found for found in asked.raw(framing.encode(payload)) if isinstance(found, m.Ack)]
        assert answers == [m.Ack(request=payload[0], code=code, detail=len(payload), tag=5)], payload


def test_damaged_bytes_are_not_answered_and_the_next_request_is(asked):
    rng = np.random.default_rng(2)
    assert not [f for f in asked.raw(rng.bytes(600)) if not isinstance(f, m.Event)]
    assert isinstance(asked.ask(m.HelloRequest(tag=1)), m.Hello)


def test_frames_count_scans_across_start_and_stop(asked):
    assert asked.ask(m.Start(1, frames=4)) == m.Ack(request=2, code=Code.OK, detail=0, tag=1)
    for number, before in ((2, 4), (3, 6)):
        for _ in range(200):  # an emulator on a busy machine takes its time
            heard = [found.sequence for found in asked.listen(0.3) if isinstance(found, Frame)]
            assert heard == sorted(heard)
            assert all(sequence < before for sequence in heard)
            if not asked.ask(m.HelloRequest()).flags & HelloFlag.STREAMING:
                break
        assert asked.ask(m.Stop(number)).detail == before
        if before == 4:
            assert asked.ask(m.Start(3, frames=2)).detail == 4


def test_the_first_scan_begins_with_start_and_the_others_follow_at_the_rate(clocked):
    clocked.ask(m.TimeRequest())  # 5 ms pass with each question
    before_us = clocked.ask(m.TimeRequest()).device_us + 5_000
    said = clocked.raw(framing.encode(m.Start(1, frames=40).pack()), 0.5)
    frames = [found for found in said if isinstance(found, Frame)]
    assert [frame.sequence for frame in frames] == list(range(40))
    assert [bool(frame.flags & FrameFlag.FIRST) for frame in frames[:3]] == [True, False, False]
    # The core is polled every 50 us; a scan passes fourteen drives, each of which may wait for the next poll.
    assert frames[0].device_us - before_us == pytest.approx(PAPER.settle_us * 14, abs=15 * 50 + 4 * 1000)
    assert np.abs(np.diff([frame.device_us for frame in frames[1:]]) - 5000).max() <= 100


def test_a_change_of_mode_acts_at_once_and_marks_its_frames(clocked):
    clocked.ask(m.Start(1))
    assert clocked.ask(m.SetMode(2, Mode.IDLE)) == m.Ack(request=4, code=Code.OK, detail=1, tag=2)
    frames = [found for found in clocked.listen(1.0) if isinstance(found, Frame)]
    idle = [frame for frame in frames if frame.flags & FrameFlag.IDLE]
    assert len(idle) >= len(frames) - 1
    assert all(frame.drives == PAPER.idle_drives and len(frame.counts) == 49 for frame in idle)
    assert len(idle) == pytest.approx(PAPER.idle_rate_mHz / 1000, abs=2)
    hello = clocked.ask(m.HelloRequest(3))
    assert (hello.rate_mHz, hello.rows) == (200_000, 104), "HELLO describes the active mode"
    assert hello.flags & HelloFlag.IDLE
    switched = clocked.raw(b"\0" + framing.encode(m.SetMode(4, Mode.ACTIVE).pack()), 0.012)
    first = next(found for found in switched if isinstance(found, Frame) and not found.flags & FrameFlag.IDLE)
    assert first.drives == 0xFFFF, "a whole scan within 12 ms, though idle scans are 50 ms apart"
    sequences = [frame.sequence for frame in frames]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    assert clocked.ask(m.SetMode(5, 2)) == m.Ack(request=4, code=Code.BAD_VALUE, detail=2, tag=5)


def test_a_mode_that_the_configuration_does_not_have_is_refused(asked):
    assert asked.flash(replace(FAST, idle_drives=0, idle_rate_mHz=0)).code == Code.OK
    asked.restart(9)
    assert asked.ask(m.SetMode(5, Mode.IDLE)) == m.Ack(request=4, code=Code.BAD_VALUE, detail=1, tag=5)


def test_random_requests_are_answered_alike_by_the_core_and_the_virtual_skin(core, tmp_path):
    rng = np.random.default_rng(int(os.environ.get("EITSKIN_SEED", "5")))
    first, second = CoreAsked(tmp_path), VirtualAsked(tmp_path)
    kinds = [m.ConfigBegin, m.ConfigWrite, m.ConfigVerify, m.ConfigCommit, m.ConfigConfirm, m.ConfigRollback,
             m.ConfigAbort, m.Restart, m.ConfigRead, m.SetMode, "wait", "flash"]  # fmt: skip
    codes = set()
    for number in range(2500):
        made, token = kinds[rng.integers(len(kinds))], int(rng.choice([0, 5, 5, 5, 5, 6]))
        wanted = (FAST, FULL, PAPER)[rng.integers(3)]
        at, length = 4 * int(rng.integers(0, 17)), 4 * int(rng.integers(1, 9))
        if made in ("wait", "flash"):  # the answers to a flash are only complete where no restart is under way
            pause_s = float(rng.choice([0.03, 4.0, 31.0], p=[0.8, 0.1, 0.1]))
            first.listen(pause_s)
            second.listen(pause_s)
        if made == "flash":
            assert first.flash(wanted, 5) == second.flash(wanted, 5), f"step {number}"
        if made in ("wait", "flash"):
            continue
        request = {
            m.ConfigBegin: lambda t=token, w=wanted: begin(w, t, revision=int(rng.integers(0, 3))),
            m.ConfigWrite: lambda t=token, w=wanted, a=at, n=length: m.ConfigWrite(t, a, w.to_blob()[a : a + n], 1),
            m.ConfigVerify: lambda t=token: m.ConfigVerify(t),
            m.ConfigCommit: lambda t=token, w=wanted: m.ConfigCommit(t, w.digest),
            m.ConfigConfirm: lambda w=wanted: m.ConfigConfirm(second.device.store.generation, w.digest),
            m.ConfigRollback: lambda t=token: m.ConfigRollback(t, second.device.store.generation),
            m.ConfigAbort: lambda t=token: m.ConfigAbort(t),
            m.Restart: lambda t=token: m.Restart(t),
            m.ConfigRead: lambda a=at, n=length: m.ConfigRead(1, int(rng.integers(0, 2)), a, n),
            m.SetMode: lambda: m.SetMode(1, int(rng.integers(0, 3))),
        }[made]()
        answers = [device.raw(framing.encode(request.pack())) for device in (first, second)]
        plain = [[found for found in said if not isinstance(found, m.Event)] for said in answers]
        assert plain[0] == plain[1], f"request {number}: {request}"
        codes |= {found.code for found in plain[0] if isinstance(found, m.Ack)}
    wanted_codes = {Code.OK, Code.BUSY, Code.NO_SESSION, Code.BAD_OFFSET, Code.INCOMPLETE, Code.NOT_CONFIRMED,
                    Code.WRONG_GENERATION, Code.DOWNGRADE, Code.NO_PREVIOUS}  # fmt: skip
    assert wanted_codes <= codes, f"too few paths were taken: {sorted(codes)}"
