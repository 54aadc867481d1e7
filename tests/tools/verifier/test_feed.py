"""What the frame loop hands to the verifier, without a process: a mailbox that nobody reads."""

from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.messaging.frame_record import PUBLISH, FrameRecord
from eitskin.messaging.verified.message import STARTING
from eitskin.reference.captured import Reference
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.evaluation.verified.resting import FRAMES
from eitskin_tools.verifier.feed import REMEMBERED, VerifierFeed
from eitskin_tools.verifier.letters import RestLetter
from eitskin_tools.verifier.mailbox import REST, Mailbox

NOISE = 3e-3


class Line:
    """A runtime's parts as far as a handover sees them, and frames by hand."""

    def __init__(self, mailbox):
        self.change, self.rng = np.zeros((1, 104), dtype=np.float32), np.random.default_rng(3)
        buffers = SimpleNamespace(change=self.change, map=np.zeros((1, 1350), dtype=np.float32), geometry=None)
        pipeline = SimpleNamespace(
            buffers=buffers, health=None, skin=PAPER, normaliser=SimpleNamespace(volts_per_count=0.0),
            bundle=SimpleNamespace(id="b", labels="area", touch_kind="raise"),
            intake=SimpleNamespace(tell_next=lambda event: None),
        )  # fmt: skip
        reference = Reference(np.ones(104), np.full(104, NOISE), 100, "s", 0, "c", "")
        skin = SimpleNamespace(pipeline=pipeline, reference=reference, loop=SimpleNamespace(run_id="r"))
        publisher = SimpleNamespace(verified=True, send_beside=lambda message: None)
        process = SimpleNamespace(
            mailbox=mailbox, answers=None, state=STARTING, why="", is_late=False, ring=lambda: None
        )
        self.feed = VerifierFeed(skin, publisher, process, "always")
        self.record = FrameRecord(memoryview(buffers.map[0]).cast("B"))

    def frame(self, *, touched=False, idle=False):
        """A frame has gone out: one of a few drives leaves dV as it was."""
        record = self.record
        if not idle:
            self.change[:] = NOISE * self.rng.standard_normal(104) + 0.5 * touched
        record.touched, record.idle = touched, idle
        record.inferred, record.solver = touched and not idle, "vd2t" if touched and not idle else "none"
        record.sequence += 1
        record.stamps[PUBLISH] += 5_000_000
        self.feed.after_frame(record)


@pytest.fixture
def line():
    mailbox = Mailbox.made()
    yield Line(mailbox)
    mailbox.close()


def test_frames_of_a_few_drives_are_not_what_the_sheet_reads_at_rest(line):
    for _ in range(FRAMES):
        line.frame()
    mailbox = line.feed._process.mailbox
    _, letter = mailbox.take(REST)
    assert np.std(RestLetter.of(letter).change) < 2.0 * NOISE / np.sqrt(FRAMES)
    line.frame()
    for _ in range(2 * FRAMES):
        line.frame(idle=True)
    assert mailbox.take(REST) is None


def test_touches_that_come_and_go_while_nobody_answers_take_no_more_and_more_memory(line):
    for _ in range(REMEMBERED + 100):
        line.frame(touched=True)
        line.frame()
    assert len(line.feed._blank) == REMEMBERED
