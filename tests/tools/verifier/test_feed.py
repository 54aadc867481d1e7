"""What the frame loop hands to the verifier, without a process."""

import socket
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.frame_record import PUBLISH, FrameRecord
from eitskin.messaging.streams.verified import READY, STARTING
from eitskin.reference.captured import Reference
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.evaluation.verified.untouched_baseline import FRAMES
from eitskin_tools.verifier.feed import VerifierFeed
from eitskin_tools.verifier.letters import (
    FRAME,
    LARGEST_PACKET,
    REST,
    SETUP,
    FrameLetter,
    RestLetter,
    state_answer,
    unpack,
    verdict_answer,
)

NOISE = 3e-3


class Line:
    """A runtime's parts as far as a feed sees them, frames by hand, and the verifier's end of its line."""

    def __init__(self, mode="always"):
        self.change, self.rng = np.zeros((1, 104), dtype=np.float32), np.random.default_rng(3)
        buffers = SimpleNamespace(change=self.change, map=np.zeros((1, 1350), dtype=np.float32), geometry=None)
        pipeline = SimpleNamespace(
            buffers=buffers, health=None, skin=PAPER, normaliser=SimpleNamespace(volts_per_count=0.0),
            bundle=SimpleNamespace(id="b", labels="area", touch_kind="raise"),
            intake=SimpleNamespace(add_event=lambda event: None),
        )  # fmt: skip
        reference = Reference(np.ones(104), np.full(104, NOISE), 100, "s", 0, "c", "")
        skin = SimpleNamespace(pipeline=pipeline, reference=reference, loop=SimpleNamespace(run_id="r"))
        publisher = SimpleNamespace(verified=True, send_beside=lambda message: None)
        ours, self.verifier = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for end in (ours, self.verifier):
            end.setblocking(False)
        process = SimpleNamespace(line=ours, state=STARTING, why="", is_late=False)
        self.feed = VerifierFeed(skin, publisher, process, mode)
        self.record = FrameRecord(memoryview(buffers.map[0]).cast("B"))

    def frame(self, *, touched=False, idle=False):
        """A frame has gone out: one of a few drives leaves dV as it was."""
        record = self.record
        if not idle:
            self.change[:] = NOISE * self.rng.standard_normal(104) + 0.5 * touched
        record.touched, record.idle = touched, idle
        record.inferred, record.solver = touched and not idle, "vd2t" if touched and not idle else "none"
        record.sequence += 1
        record.stamps[PUBLISH] += 50_000_000
        self.feed.after_frame(record)

    def received(self, kind):
        """Return the packets of a kind that the verifier has got, without their kind."""
        found = []
        with suppress(BlockingIOError):
            while True:
                found.append(unpack(self.verifier.recv(LARGEST_PACKET)))
        return [items for one, *items in found if one == kind]


@pytest.fixture
def line():
    found = Line()
    yield found
    found.verifier.close()
    found.feed._process.line.close()


def test_frames_of_a_few_drives_are_not_what_the_sheet_reads_at_rest(line):
    for _ in range(FRAMES + 1):
        line.frame()
    (letter,) = line.received(REST)
    assert np.std(RestLetter.of(*letter).change) < 2.0 * NOISE / np.sqrt(FRAMES)
    for _ in range(2 * FRAMES):
        line.frame(idle=True)
    assert line.received(REST) == []


def test_the_newest_frame_goes_to_a_verifier_that_is_ready_and_has_no_other(line):
    line.frame(touched=True)
    assert line.received(SETUP)[0][0] == 1
    line.change += 1.0
    line.frame(touched=True)
    assert line.received(FRAME) == [], "it makes its model"
    line.verifier.send(state_answer(READY, 1))
    line.frame(touched=True)
    (items,) = line.received(FRAME)
    sent = FrameLetter.of(*items)
    assert (sent.setup, sent.seq <= line.record.sequence) == (1, True)
    for step in range(5):
        line.rng = np.random.default_rng(step)
        line.change[:] = step
        line.frame()
        line.frame(touched=True)
    assert line.received(FRAME) == []
    skipped = line.feed.counts["skipped"]
    assert skipped >= 4
    line.verifier.send(verdict_answer(b"", False, 1.0))
    line.frame(touched=True)
    (items,) = line.received(FRAME)
    assert FrameLetter.of(*items).seq == line.record.sequence - 1
    assert line.feed.counts == {"checked": 1, "flagged": 0, "skipped": skipped}


def test_a_verifier_that_has_ended_is_not_written_to(line):
    line.frame(touched=True)
    line.verifier.close()
    for _ in range(3):
        line.frame(touched=True)
        line.frame()
