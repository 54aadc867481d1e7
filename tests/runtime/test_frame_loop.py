"""The order of a frame's way: who does what before what, and one record for all frames."""

import pytest

from eitskin.errors import PortLost
from eitskin.frame_loop import GIVE_WAY_S, DeferredWork
from eitskin.messaging.frame import unpack_frame
from eitskin.messaging.streams.envelope import FIRST_BYTE, opened
from eitskin.messaging.streams.measured import WireFrame
from eitskin.messaging.streams.publisher import StreamPublisher


class Taker:
    """Takes what comes, and notes what the loop had done by then."""

    short = False

    def __init__(self, wanted=True):
        self.wanted = wanted
        self.skin = None
        self.got = []

    def send(self, message):
        self.got.append((bytes(message), self.skin.statistics.frames))


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


class Both(Taker):
    """Takes frames and streams, and notes their order: a frame's number, or an item of the wire's stream."""

    def __init__(self):
        super().__init__()
        self.streams = StreamPublisher(self.told)
        self.streams.set_topics([FIRST_BYTE])

    def send(self, message):
        self.got.append(unpack_frame(bytes(message), 0).number)

    def told(self, message):
        found = opened(message)
        if found.name == "wire" and not (one := WireFrame.of(found.body)).withheld:  # a busy machine has old ones
            self.got.append(one)


def test_a_frame_goes_out_before_all_that_is_told_of_it(streaming):
    taker, sequences = Both(), []
    for record in streaming.publish(taker):
        sequences.append(record.sequence)
        assert len(taker.got) == 2 * len(sequences) - 1  # told when the taker has the frame
        if len(sequences) == 10:
            break
    frames, told = taker.got[::2], taker.got[1::2]  # the last one too, although nobody comes back
    assert frames == [one.frame for one in told] == list(range(1, 11))
    assert [one.seq for one in told] == sequences


def test_what_is_left_to_do_is_done_while_the_line_rests_or_when_bytes_come_and_if_it_is_lost():
    class Line:
        def __init__(self):
            self.said = []

        def payloads(self, timeout_s):
            self.said.append(timeout_s)
            if self.answer is None:
                raise PortLost("gone")
            return self.answer

    line, done, spans = Line(), [], []
    left = DeferredWork(lambda begin_ns, end_ns: spans.append(end_ns - begin_ns))
    line.answer = [b"next"]
    assert left.payloads(line) == []
    assert not line.said  # nothing is left to do while waiting for the line
    left.put(lambda: done.append(0), done.append, 1)
    assert left.payloads(line) == [b"next"]
    assert (line.said, done) == ([GIVE_WAY_S], [1, 0])
    line.answer = []
    left.put(lambda: done.append(0), done.append, 2)
    assert left.payloads(line) == []
    line.answer = None
    left.put(lambda: done.append(0), done.append, 3)
    with pytest.raises(PortLost):
        left.payloads(line)
    left.put(lambda: done.append(0), done.append, 4)
    left.do()
    left.do()
    assert done == [1, 0, 2, 0, 3, 0, 4, 0]
    assert len(spans) == 4
