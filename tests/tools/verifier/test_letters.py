"""The mailbox and what stands in its letters: the newest, whole or not at all."""

import dataclasses
import threading

import numpy as np
import pytest

from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import to_toml
from eitskin_tools.verifier.letters import FrameLetter, RestLetter, Setup, frame_letter, rest_letter
from eitskin_tools.verifier.mailbox import FRAME, REST, SETUP, SIZES, Mailbox

SETUP_OF_PAPER = Setup(
    bundle="b", labels="units", touches="raise", skin=to_toml(PAPER), skin_digest=PAPER.digest, cloud=3,
    cloud_mm=PAPER.grid.flat_cloud_mm().astype("<f4").tobytes(), reference_V=np.ones(104).tobytes(),
    spread_V=np.full(104, 1e-3).tobytes(), budget_s=0.0,
)  # fmt: skip


@pytest.fixture
def mailboxes():
    """Return both sides of one mailbox."""
    here = Mailbox.made()
    there = Mailbox(here.descriptor)
    yield here, there
    there._memory.close()
    here.close()
    here.close()


def test_the_newest_letter_is_taken_once(mailboxes):
    here, there = mailboxes
    assert there.take(FRAME) is None
    assert here.put(FRAME, b"one") == 1
    assert here.put(FRAME, b"two", b" parts") == 2
    assert there.take(FRAME) == (2, b"two parts")
    assert there.take(FRAME) is there.take(SETUP) is None
    here.put(FRAME, b"three")
    there.skip(FRAME, 3)
    assert there.take(FRAME) is None


def test_a_letter_that_does_not_fit_is_refused(mailboxes):
    here, _ = mailboxes
    with pytest.raises(ValueError, match="expected at most 65536"):
        here.put(FRAME, bytes(SIZES[FRAME] + 1))


def test_a_letter_that_is_overwritten_meanwhile_is_whole_or_not_there(mailboxes):
    here, there = mailboxes
    ends = threading.Event()

    def write() -> None:
        for number in range(3000):
            here.put(FRAME, bytes([number % 256]) * 6000)
        ends.set()

    writer = threading.Thread(target=write)
    writer.start()
    taken = []
    while not ends.is_set() or not taken or taken[-1] != 3000:
        found = there.take(FRAME)
        if found is not None:
            assert set(found[1]) == {(found[0] - 1) % 256}
            taken.append(found[0])
    writer.join()
    assert taken == sorted(set(taken))


def test_a_cut_letter_is_not_believed(mailboxes):
    here, there = mailboxes
    here.put(FRAME, b"a" * 100)
    at = there._memory.find(b"a" * 100)
    there._memory[at + 50 : at + 51] = b"b"
    assert there.take(FRAME) is None


def test_a_frame_comes_back_as_it_was():
    rng = np.random.default_rng(1)
    missing = rng.random(104) < 0.2
    change, values = rng.standard_normal(104).astype("f4"), rng.random(1350).astype("f4")
    found = FrameLetter.of(frame_letter(7, 2**40, 5, 6, 8, 2, missing, change, values))
    assert (found.setup, found.seq, found.device_us, found.read_ns, found.publish_ns, found.cloud) == (
        7, 2**40, 5, 6, 8, 2,
    )  # fmt: skip
    for one, other in zip((found.missing, found.change, found.map), (missing, change, values), strict=True):
        assert np.array_equal(one, other)


def test_what_the_sheet_reads_at_rest_comes_back(mailboxes):
    here, there = mailboxes
    change = np.random.default_rng(1).standard_normal(104)
    here.put(FRAME, b"a frame")
    here.put(REST, rest_letter(3, 50, change))
    _, content = there.take(REST)
    found = RestLetter.of(content)
    assert (found.setup, found.frames) == (3, 50)
    assert np.array_equal(found.change, change)
    assert there.take(FRAME) == (1, b"a frame")


def test_a_setup_comes_back_and_another_skin_is_refused():
    found = Setup.of(SETUP_OF_PAPER.packed())
    assert found == SETUP_OF_PAPER
    assert found.described() == PAPER
    with pytest.raises(MismatchError, match="verifier: skin"):
        dataclasses.replace(found, skin_digest="0123456789abcdef").described()
