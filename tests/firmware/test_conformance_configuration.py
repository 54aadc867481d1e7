"""What every device that speaks the wire does with configurations: sessions, trials, restarts, rolling back."""

from dataclasses import replace

import pytest

from eitskin_proto.skin import skin
from eitskin_proto.wire import framing
from eitskin_proto.wire import messages as m
from eitskin_proto.wire.codes import Code, EventCode, HelloFlag, Slot

from .asked import FAST, FULL, PAPER, begin

SKIN = "0123456789abcdef"


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


def two_confirmed(asked):
    """Flash and confirm fast, then full208, which runs as generation 2."""
    for generation, wanted in ((1, FAST), (2, FULL)):
        asked.flash(wanted)
        asked.restart(9)
        assert asked.ask(m.ConfigConfirm(generation, wanted.digest)).code == Code.OK


def test_until_the_restart_nothing_erases_the_slot_that_a_rollback_goes_back_to(asked):
    two_confirmed(asked)
    assert asked.ask(m.ConfigRead(slot=Slot.ACTIVE)).generation == 2
    assert asked.ask(m.ConfigRollback(9, 2)).code == Code.OK
    refused = m.Ack(request=0x11, code=Code.NOT_CONFIRMED, detail=2, tag=3)
    assert asked.ask(begin(PAPER, token=9)) == refused
    assert asked.ask(begin(PAPER, token=8)) == refused, "before the lock is looked at"
    assert asked.ask(m.ConfigConfirm(2, FULL.digest)) == m.Ack(request=0x15, code=Code.NOT_CONFIRMED, detail=2)
    running, other = (asked.ask(m.ConfigRead(slot=slot, length=32)) for slot in (Slot.ACTIVE, Slot.OTHER))
    assert (running.generation, running.data) == (0, FULL.to_blob()[:32]), "it runs, and no boot will run it"
    assert other.generation == 1
    asked.power_cycle()
    hello = asked.ask(m.HelloRequest())
    assert (hello.generation, hello.configuration_name, hello.flags) == (1, "fast", 0)
    assert asked.ask(begin(PAPER)).code == Code.OK, "after the restart the revoked slot is free"
    asked.power_cycle()
    assert asked.ask(m.HelloRequest()).generation == 1


def test_a_rollback_ends_a_trial_for_good(asked):
    two_confirmed(asked)
    asked.flash(PAPER)
    assert asked.restart(9).flags == HelloFlag.TRIAL
    assert asked.ask(m.ConfigRollback(9, 3)).code == Code.OK
    assert asked.ask(m.ConfigConfirm(3, PAPER.digest)).code == Code.NOT_CONFIRMED
    assert asked.ask(begin()).code == Code.NOT_CONFIRMED
    assert asked.restart(9).generation == 2


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


def test_a_configuration_that_states_its_skin_says_so_in_hello(asked):
    assert asked.ask(m.HelloRequest()).grid_id == skin.PAPER.grid_id
    stated = replace(FAST, skin=SKIN)
    assert asked.flash(stated).code == Code.OK
    hello = asked.restart(9)
    assert (hello.grid_id, hello.configuration_name, hello.configuration_digest) == (SKIN, "fast", stated.digest)
    pieces = [asked.ask(m.ConfigRead(slot=Slot.ACTIVE, offset=at, length=32)).data for at in (0, 32)]
    assert b"".join(pieces) == stated.to_blob()


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
        (resealed(FAST.to_blob(), flags=(59, 1)), Code.INVALID_CONFIGURATION),  # a skin's digest is not all 0
        (resealed(FAST.to_blob(), flags=(59, 2)), Code.INVALID_CONFIGURATION),
        (resealed(replace(FAST, skin=SKIN).to_blob(), flags=(59, 0)), Code.INVALID_CONFIGURATION),  # no letters
        (resealed(replace(FAST, skin=SKIN).to_blob(), name=(19, 200)), Code.INVALID_CONFIGURATION),
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
