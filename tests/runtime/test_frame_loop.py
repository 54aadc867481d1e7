"""The order of a frame's way: who does what before what, and one record for all frames."""

import time
from itertools import pairwise

import pytest

from eitskin.errors import PortLost
from eitskin.frame_loop import GIVE_WAY_S, DeferredWork
from eitskin.frame_record import STAGES
from eitskin.messaging.frame import unpack_frame
from eitskin.messaging.streams.envelope import CLOUD, CONDITIONS, FIRST_BYTE, STATE, TOPICS, WIRE, opened
from eitskin.messaging.streams.measured import WireFrame
from eitskin.messaging.streams.publisher import StreamPublisher
from eitskin.pipeline.stats import Statistics
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


class Both(Taker):
    """Takes frames and streams, and notes in which order they come: a frame's number, or what is told of the wire."""

    def __init__(self, topics):
        super().__init__()
        self.streams = StreamPublisher(self.told)
        self.streams.set_topics(topics)

    def send(self, message):
        self.got.append(unpack_frame(bytes(message), 0).number)

    def told(self, message):
        found = opened(message)
        if found.name == "wire" and not (one := WireFrame.of(found.body)).withheld:  # a busy machine has old ones
            self.got.append(one)


@pytest.mark.parametrize(("topics", "first"), [([FIRST_BYTE], False), ([b"", FIRST_BYTE], True)])
def test_a_frame_goes_out_before_all_that_is_told_of_it_unless_somebody_takes_everything(streaming, topics, first):
    taker, sequences = Both(topics), []
    for record in streaming.publish(taker):
        sequences.append(record.sequence)
        assert len(taker.got) == 2 * len(sequences) - (not first)  # told when whoever asked for the frame has it
        if len(sequences) == 10:
            break
    frames, told = taker.got[first::2], taker.got[not first :: 2]  # the last one too, although nobody comes back
    assert frames == [one.frame for one in told] == list(range(1, 11))
    assert [one.seq for one in told] == sequences


class Names(Both):
    """Notes which stream each message is of."""

    def send(self, message):
        pass

    def told(self, message):
        self.got.append(opened(message).name)


def test_a_newcomer_is_told_at_once_whatever_it_asks_for(streaming):
    """Its topics come one by one, as libzmq sorts them, and frames between them; then others come with each frame."""
    topics, asked, begins = [WIRE, CLOUD, STATE, CONDITIONS], [TOPICS[STATE]], []
    taker = Names(asked)
    for _ in streaming.publish(taker):
        if len(begins) == 10:
            break
        if len(begins) < len(topics):
            asked.append(TOPICS[topics[len(begins)]])
        taker.streams.set_topics(asked)
        begins.append(len(taker.got))
    told = [taker.got[one:two] for one, two in pairwise([*begins, None])]
    for name, found in zip(topics, told[: len(topics)], strict=True):
        assert name in found
    for found in told[len(topics) - 1 : -1]:
        assert (found[0], found[-1], found.count(WIRE)) == (CONDITIONS, WIRE, 1)


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
    assert not line.said  # nothing is left: whoever waits for the line waits by himself
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


def test_what_is_told_never_waits_for_a_later_frame(virtual_skin, tiny_path):
    """Frames that come together, as after a pause, are told of one by one, each before the next is looked at."""
    with virtual_skin(touches=[[0.1, 60, 0.3]], rate_hz=100.0) as port, Skin(port, bundle=tiny_path) as skin:
        skin.capture_reference(5)
        taker = Both([FIRST_BYTE])
        for _ in skin.publish(taker):
            if skin.published == 3:
                time.sleep(0.1)
            if skin.published == 20:
                break
    assert [one if isinstance(one, int) else one.frame for one in taker.got] == [n // 2 for n in range(2, 42)]


def test_what_is_left_of_a_period_is_from_ready_to_read():
    statistics = Statistics(capacity=4)
    for frame in range(7):  # more than are kept: the oldest is overwritten first
        read_ns = 5_000_000 * frame
        stamps = [read_ns + 1000 * stage for stage in range(len(STAGES))]
        statistics.add(stamps, "none", False, (), ())
        if frame < 6:  # the last one was handed over, and nobody came back
            statistics.ready(read_ns + 10_000 + 1000 * frame)
            statistics.told(read_ns + 1_996_000 + 1000 * frame, read_ns + 2_000_000 + 1000 * frame)
    found = statistics.summary()
    assert found["behind_us"]["streams"] == {"p50": 4.0, "p99": 4.0, "p999": 4.0, "max": 4.0}
    assert found["behind_us"]["rest"]["max"] == 9.0
    assert found["left_us"] == {"p50": 2996.0, "p1": 2995.0, "min": 2995.0}
    assert found["latency_us"]["max"] == 6.0
