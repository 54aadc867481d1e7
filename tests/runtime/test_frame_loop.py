"""The order of a frame's way: who does what before what, and one record for all frames."""

import pytest

from eitskin.messaging.frame import STAGES, unpack_frame
from eitskin.skin import Skin


class Taker:
    """Takes what comes, and notes what the loop had done by then."""

    short = False

    def __init__(self, wanted=True):
        self.wanted = wanted
        self.skin = None
        self.got = []

    def send(self, message):
        self.got.append((bytes(message), self.skin.statistics.frames))


@pytest.fixture
def streaming(virtual_skin, tiny_path):
    with virtual_skin(touches=[[0.1, 60, 0.3]], rate_hz=100.0) as port, Skin(port, bundle=tiny_path) as skin:
        skin.capture_reference(5)
        yield skin


def test_a_frame_is_handed_over_before_it_is_counted_and_counted_before_it_is_told(streaming):
    taker = Taker()
    taker.skin = streaming
    records = set()
    for seen, record in enumerate(streaming.publish(taker), 1):
        message, counted = taker.got[-1]
        assert (len(taker.got), counted, streaming.statistics.frames) == (seen, seen - 1, seen)
        assert record.stamps == sorted(record.stamps)
        assert unpack_frame(message, 0).sequence == record.sequence
        records.add(id(record))
        if seen == 20:
            break
    assert len(records) == 1  # one record, overwritten
    assert streaming.published == 20
    assert repr(streaming).endswith(f"on {streaming.transport.name}: open, 20 frames>")


def test_what_nobody_wants_is_counted_and_neither_computed_nor_packed(streaming):
    taker = Taker(wanted=False)
    for record in streaming.publish(taker):
        assert (record.solver, record.inferred) == ("none", False)
        assert record.stamps[STAGES.index("pack")] == record.stamps[STAGES.index("infer")]
        if streaming.statistics.frames == 10:
            break
    assert taker.got == []
    assert streaming.published == 0
    taker.wanted, taker.skin = True, streaming
    next(iter(streaming.publish(taker)))
    assert unpack_frame(taker.got[0][0], 0).number == 1
