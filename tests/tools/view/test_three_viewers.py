"""Three viewers of one stream of 200 frames a second: nobody else loses a frame, no page gets more than 30 pictures."""

import time
from contextlib import ExitStack

import pytest
from tests.tools.studies.study import study

import eitskin
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.view.source import Source
from eitskin_tools.view.viewer import Viewer

from .scripted import Runtime, Scene, disc

readers = study("recording").readers

FRAMES, MOST_HZ = 600, 30
PICTURES = 20
"""Of each page, before it is enough."""

pytestmark = [pytest.mark.process, pytest.mark.slow]


@pytest.fixture
def viewers(endpoint):
    with ExitStack() as stack:
        yield [stack.enter_context(Viewer([Source(PAPER, endpoint)])) for _ in range(3)]


def takes(other, frames):
    """Take so many frames, one after the other, and check that none is missing."""
    numbers = [other.next_frame().number for _ in range(frames)]
    assert numbers == list(range(numbers[0], numbers[0] + frames))
    return numbers[-1]


def test_a_subscriber_loses_no_frame_and_no_page_gets_more_than_it_can_show(endpoint, viewers):
    with (
        Runtime(endpoint, Scene(disc(50.0, 40.0)), rate_hz=200.0),
        eitskin.subscribe(endpoint, mode="all", timeout_s=60.0) as other,
        ExitStack() as stack,
    ):
        counts = [stack.enter_context(readers(viewer.address, 1)) for viewer in viewers]
        begin_s, last = time.monotonic(), takes(other, FRAMES)
        while min(count[0] for count in counts) < PICTURES:
            last = takes(other, 20)
        most = MOST_HZ * (time.monotonic() - begin_s) + 3  # what each had come with, and what is on its way
        assert other.lost == 0
        assert all(PICTURES <= count[0] <= most for count in counts), (counts, most)
        assert sum(viewer.feeds[0].taken for viewer in viewers) < 3 * last
