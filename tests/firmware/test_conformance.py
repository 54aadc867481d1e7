"""One set of questions for every device that speaks the wire: the C core, the virtual skin, and the emulated board.

What SPEC.md says is asked here once; what only one of them has (faults, storage that tears) is tested beside it.
"""

import os
from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.wire import framing
from eitskin_proto.wire import messages as m
from eitskin_proto.wire.codes import Code, EventCode, FrameFlag, HelloFlag, Mode, Slot
from eitskin_proto.wire.frames import Frame
from eitskin_tools.emulator.firmware import missing_tools

from .asked import DEVICES, FAST, FULL, PAPER, CoreAsked, VirtualAsked, begin


def _asked(name, folder):
    made, needs = DEVICES[name]
    missing = missing_tools(needs) if needs else []
    if missing:
        pytest.skip(f"{', '.join(missing)} not found: see tools/system-packages.sh")
    device = made(folder)
    try:
        yield device
    finally:
        device.close()


@pytest.fixture(params=DEVICES)
def asked(request, tmp_path):
    """Return each device in turn."""
    yield from _asked(request.param, tmp_path)


@pytest.fixture(params=["core", "virtual"])
def clocked(request, tmp_path):
    """Return those whose clock a test can move; an emulator keeps no times, and boots for each of many cases."""
    yield from _asked(request.param, tmp_path)


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
        for _ in range(20):  # an emulator on a busy machine takes its time
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


def test_a_flashed_configuration_runs_on_trial_and_stays_once_confirmed(asked):
    assert asked.flash(FAST) == m.Ack(request=0x14, code=Code.OK, detail=1, tag=0)
    assert asked.ask(m.ConfigCommit(9, FAST.digest)).detail == 1, "asked again, it is not committed twice"
    assert asked.ask(m.HelloRequest()).generation == 0
    hello = asked.restart(9)
    assert (hello.generation, hello.configuration_digest, hello.flags) == (1, FAST.digest, HelloFlag.TRIAL)
    assert asked.ask(begin(PAPER)) == m.Ack(request=0x11, code=Code.NOT_CONFIRMED, detail=1, tag=3)
    assert asked.ask(m.ConfigConfirm(1, FAST.digest ^ 1)).code == Code.WRONG_GENERATION
    assert asked.ask(m.ConfigConfirm(2, FAST.digest)) == m.Ack(request=0x15, code=Code.WRONG_GENERATION, detail=1)
    for _ in range(2):
        assert asked.ask(m.ConfigConfirm(1, FAST.digest)) == m.Ack(request=0x15, code=Code.OK, detail=1)
    asked.power_cycle()
    assert asked.ask(m.HelloRequest()).flags == 0


def test_an_unconfirmed_configuration_is_given_up_at_the_next_boot(asked):
    asked.flash(FAST)
    assert asked.restart(9).flags == HelloFlag.TRIAL
    asked.power_cycle()
    hello = asked.ask(m.HelloRequest())
    assert (hello.generation, hello.flags) == (0, HelloFlag.FACTORY | HelloFlag.ROLLED_BACK)
    assert asked.ask(m.ConfigRead(slot=Slot.OTHER)).total == 64, "it is still there to be looked at"
    asked.flash(FULL)
    assert asked.restart(9).generation == 2, "a number is not given twice"


def test_a_trial_without_confirmation_ends_by_itself_after_30_s(clocked):
    clocked.flash(FAST)
    clocked.restart(9)
    clocked.listen(29.0)
    assert clocked.ask(m.HelloRequest()).flags == HelloFlag.TRIAL
    events = [found.code for found in clocked.listen(1.5) if isinstance(found, m.Event)]
    assert events == [EventCode.RESTARTING, EventCode.ROLLED_BACK]
    assert clocked.ask(m.HelloRequest()).flags == HelloFlag.FACTORY | HelloFlag.ROLLED_BACK


def test_a_restart_says_so_before_and_what_runs_after_it(asked):
    said = asked.until_restarted(m.Restart(0, tag=4))
    assert [found.code for found in said] == [Code.OK, EventCode.RESTARTING, EventCode.CONFIGURATION_CHANGED]
    assert [type(found) for found in said] == [m.Ack, m.Event, m.Event]
    assert said[2].detail == 0, "its generation"


def test_a_restart_that_is_asked_for_again_because_its_answer_was_lost_ends_no_trial(asked):
    asked.flash(FAST)
    assert asked.ask(m.Restart(8)).code == Code.BUSY
    assert asked.ask(m.Restart(0)).code == Code.BUSY
    assert asked.restart(9).flags == HelloFlag.TRIAL
    assert asked.ask(m.Restart(9)) == m.Ack(request=0x18, code=Code.NO_SESSION, detail=0)
    asked.listen(asked.restart_s)
    assert asked.ask(m.HelloRequest()).flags == HelloFlag.TRIAL


def test_rolling_back_runs_the_slot_before(asked):
    for generation, wanted in ((1, FAST), (2, FULL)):
        assert asked.flash(wanted).detail == generation
        asked.restart(9)
        assert asked.ask(m.ConfigConfirm(generation, wanted.digest)).code == Code.OK
    assert asked.ask(m.ConfigRollback(9, 1)) == m.Ack(request=0x16, code=Code.WRONG_GENERATION, detail=2)
    assert asked.ask(m.ConfigRollback(0, 2)) == m.Ack(request=0x16, code=Code.BAD_VALUE, detail=0)
    for _ in range(2):
        assert asked.ask(m.ConfigRollback(9, 2)) == m.Ack(request=0x16, code=Code.OK, detail=2)
    assert asked.ask(m.HelloRequest()).generation == 2
    assert asked.restart(9).configuration_name == "fast"
    assert asked.ask(m.ConfigRollback(9, 1)) == m.Ack(request=0x16, code=Code.NO_PREVIOUS, detail=1)
    assert asked.ask(m.ConfigRead(slot=Slot.OTHER)).code == Code.NO_PREVIOUS, "the revoked one counts for nothing"


def test_nothing_is_changed_while_streaming(asked):
    asked.ask(m.Start(1))
    for request in (begin(), m.ConfigRollback(9, 0)):
        said = asked.raw(framing.encode(request.pack()))
        answers = [found for found in said if isinstance(found, m.Ack)] or [
            found for found in asked.listen(0.5) if isinstance(found, m.Ack)
        ]
        assert [answer.code for answer in answers] == [Code.STREAMING]
    asked.send(framing.encode(m.Stop(2).pack()))


def test_a_second_session_is_told_to_wait(asked):
    assert asked.ask(begin(token=5)) == m.Ack(request=0x11, code=Code.OK, detail=64, tag=3)
    for request in (begin(token=6), m.ConfigWrite(6, 0, bytes(4)), m.ConfigVerify(6), m.ConfigCommit(6, 1),
                    m.ConfigAbort(6), m.ConfigRollback(6, 0), m.Restart(6)):  # fmt: skip
        answer = asked.ask(request)
        assert answer.code == Code.BUSY, request
        assert 5_000 < answer.detail <= 10_001
    assert asked.ask(m.ConfigWrite(5, 0, FAST.to_blob()[:32])).code == Code.OK, "the first one goes on"
    assert asked.ask(m.ConfigAbort(5)).code == Code.OK
    assert asked.ask(m.ConfigAbort(5)).code == Code.NO_SESSION
    assert asked.ask(begin(token=6)).code == Code.OK


def test_a_lock_expires_after_ten_seconds_of_silence(clocked):
    clocked.ask(begin(token=5))
    clocked.listen(9.0)
    assert clocked.ask(m.ConfigVerify(5)).code == Code.INCOMPLETE, "speaking keeps the lock"
    clocked.listen(9.0)
    assert clocked.ask(begin(token=6)).code == Code.BUSY
    clocked.listen(1.1)
    assert clocked.ask(m.ConfigWrite(5, 0, bytes(4))).code == Code.NO_SESSION
    assert clocked.ask(begin(token=6)).code == Code.OK


@pytest.mark.parametrize(
    ("changes", "code", "detail"),
    [
        ({"hardware_id": 7}, Code.WRONG_HARDWARE, FAST.hardware_id),
        ({"format": 2}, Code.BAD_FORMAT, 1),
        ({"size": 65}, Code.TOO_LARGE, 64),
        ({"size": 32}, Code.TOO_LARGE, 64),
        ({"token": 0}, Code.BAD_VALUE, 0),
        ({"name": "paper", "revision": 0}, Code.DOWNGRADE, 1),
        ({"name": "paper", "revision": 0, "allow_downgrade": 1}, Code.OK, 64),
        ({"name": "other", "revision": 0}, Code.OK, 64),
        ({"hardware_id": 7, "format": 2, "size": 1, "token": 0}, Code.WRONG_HARDWARE, FAST.hardware_id),
    ],
)
def test_begin_refuses_what_must_not_be_written(clocked, changes, code, detail):
    assert clocked.ask(begin(**changes)) == m.Ack(request=0x11, code=code, detail=detail, tag=3)
    if code != Code.OK:
        assert clocked.ask(m.ConfigWrite(9, 0, bytes(4))).code == Code.NO_SESSION


def test_chunks_follow_each_other_and_may_be_repeated(asked):
    blob = FAST.to_blob()
    asked.ask(begin())
    answers = [
        asked.ask(request)
        for request in (
            m.ConfigWrite(9, 4, blob[4:8]), m.ConfigWrite(9, 0, blob[:3]), m.ConfigWrite(9, 0, b""),
            m.ConfigWrite(9, 0, blob[:32]), m.ConfigWrite(9, 0, blob[:32]), m.ConfigWrite(9, 0, blob[32:]),
            m.ConfigVerify(9), m.ConfigCommit(9, FAST.digest), m.ConfigWrite(9, 32, blob[32:]),
            m.ConfigWrite(9, 64, blob[:4]), m.ConfigCommit(9, FAST.digest ^ 1), m.ConfigVerify(9),
        )
    ]  # fmt: skip
    assert [(answer.code, answer.detail) for answer in answers] == [
        (Code.BAD_OFFSET, 0), (Code.BAD_VALUE, 3), (Code.BAD_VALUE, 0), (Code.OK, 32), (Code.OK, 32),
        (Code.BAD_OFFSET, 32), (Code.INCOMPLETE, 32), (Code.INCOMPLETE, 32), (Code.OK, 64), (Code.BAD_OFFSET, 64),
        (Code.DIGEST_MISMATCH, FAST.digest), (Code.OK, FAST.digest),
    ]  # fmt: skip


def test_what_is_written_is_read_back_and_what_is_not_is_erased(asked):
    blob = FAST.to_blob()
    assert asked.ask(m.ConfigRead(slot=Slot.OTHER)).code == Code.NO_PREVIOUS
    asked.ask(begin())
    asked.ask(m.ConfigWrite(9, 0, blob[:32]))
    pieces = [asked.ask(m.ConfigRead(7, Slot.OTHER, at, 32)) for at in (0, 32)]
    assert [piece.data for piece in pieces] == [blob[:32], b"\xff" * 32]
    assert [(piece.tag, piece.generation, piece.offset, piece.total) for piece in pieces] == [
        (7, 0, 0, 64), (7, 0, 32, 64)
    ]  # fmt: skip
    asked.ask(m.ConfigWrite(9, 32, blob[32:]))
    asked.ask(m.ConfigCommit(9, FAST.digest))
    assert asked.ask(m.ConfigRead(slot=Slot.OTHER, offset=60, length=4)).generation == 1
    assert asked.ask(m.ConfigRead(slot=Slot.ACTIVE, offset=60, length=4)).data == PAPER.digest.to_bytes(4, "little")
    asked.ask(begin(FULL))
    assert asked.ask(m.ConfigCommit(9, FULL.digest)).code == Code.INCOMPLETE, "begin again starts over"
    asked.flash(FULL)
    assert asked.ask(m.ConfigRead(slot=Slot.OTHER)).generation == 2


@pytest.mark.parametrize("changes", [{"slot": 2}, {"offset": 60, "length": 8}, {"length": 0}, {"length": 33}])
def test_a_read_outside_the_configuration_is_refused(clocked, changes):
    answer = clocked.ask(m.ConfigRead(**{"length": 4, **changes}))
    assert (answer.code, answer.detail) == (Code.BAD_VALUE, 64)


def resealed(blob: bytes, **changes: tuple[int, int]) -> bytes:
    body = bytearray(blob[:60])
    for at, byte in changes.values():
        body[at] = byte
    return bytes(body) + framing.crc32c(bytes(body)).to_bytes(4, "little")


@pytest.mark.parametrize(
    ("blob", "code"),
    [
        (replace(FAST, hardware_id=99).to_blob(), Code.WRONG_HARDWARE),
        (replace(FAST, rate_mHz=900_000).to_blob(), Code.RATE_TOO_HIGH),
        (replace(FAST, idle_rate_mHz=90_000_000).to_blob(), Code.RATE_TOO_HIGH),
        (replace(FAST, rate_mHz=900_000, gain=5).to_blob(), Code.INVALID_CONFIGURATION),
        (replace(FAST, gain=5).to_blob(), Code.INVALID_CONFIGURATION),
        (replace(FAST, frequency_hz=3_000_000_000).to_blob(), Code.INVALID_CONFIGURATION),
        (resealed(FAST.to_blob(), name=(16, 7)), Code.INVALID_CONFIGURATION),
        (resealed(FAST.to_blob(), reserved=(59, 1)), Code.INVALID_CONFIGURATION),
        (resealed(FAST.to_blob(), format=(4, 2)), Code.BAD_FORMAT),
        (resealed(FAST.to_blob(), magic=(0, 7)), Code.DIGEST_MISMATCH),
        (FAST.to_blob()[:-1] + b"\0", Code.DIGEST_MISMATCH),
    ],
)
def test_a_blob_that_means_nothing_is_not_committed(clocked, blob, code):
    digest = int.from_bytes(blob[-4:], "little")
    clocked.ask(begin(digest=digest))
    for at in (0, 32):
        assert clocked.ask(m.ConfigWrite(9, at, blob[at : at + 32])).code == Code.OK
    assert clocked.ask(m.ConfigVerify(9)).code == code
    assert clocked.ask(m.ConfigCommit(9, digest)).code == code
    clocked.ask(m.ConfigAbort(9))
    clocked.power_cycle()
    assert clocked.ask(m.HelloRequest()).flags == HelloFlag.FACTORY


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
