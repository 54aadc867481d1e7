import time
from contextlib import ExitStack

import msgpack
import pytest
import zmq

import eitskin
from eitskin.errors import NoFrame, StaleFrame
from eitskin.messaging import publish
from eitskin.messaging.frame import EVERY_FRAME

from .publishing import send, wait_for, wait_until_wanted


def test_frames_reach_a_subscriber_and_the_publisher_knows_that_it_is_wanted(publisher, packer):
    assert not publisher.wanted
    with eitskin.subscribe(publisher.endpoint, timeout_s=60) as frames:
        wait_until_wanted(publisher)
        send(publisher, packer, 1)
        assert next(frames).number == 1
    wait_for(publisher, lambda: not publisher.wanted)


def test_a_slow_subscriber_sees_the_newest_frame_and_delays_nobody(publisher, packer):
    with ExitStack() as stack:
        slow = stack.enter_context(eitskin.subscribe(publisher.endpoint, timeout_s=60))
        wait_until_wanted(publisher)
        recorder = stack.enter_context(eitskin.subscribe(publisher.endpoint, mode="all", timeout_s=60))
        wait_until_wanted(publisher)
        numbers = []
        for number in range(1, 1001):  # all in one thread: a publisher that waited for either would wait for ever
            send(publisher, packer, number)
            if number % 100 == 0:
                time.sleep(0.02)  # the slow one wakes ten times
                while next(slow).number < number:
                    pass  # on a busy machine the newest may need a moment to arrive
            if number % 250 == 0:  # a second's worth and more waits in its queue
                numbers += [next(recorder).number for _ in range(250)]
        assert publisher.dropped == 0
        assert slow.received < 500
        assert slow.received + slow.lost > 800  # what it never saw is counted, from its first frame on
        assert numbers == list(range(1, 1001))
        assert recorder.lost == 0


@pytest.mark.parametrize("read", [0, 60, 120, 150, 180])
def test_as_many_frames_wait_as_are_promised_whatever_was_read_before(publisher, packer, read):
    with zmq.Context() as context, context.socket(zmq.SUB) as reader:
        reader.setsockopt(zmq.RCVHWM, 1)  # it is the publisher's queue that is asked for
        reader.setsockopt(zmq.RCVTIMEO, 60_000)
        reader.setsockopt(zmq.SUBSCRIBE, EVERY_FRAME)
        reader.connect(publisher.endpoint)
        wait_until_wanted(publisher)
        for number in range(1, read + 1):
            send(publisher, packer, number)
            reader.recv()
        for number in range(read + 1, read + publish.QUEUE_FRAMES + 1):
            send(publisher, packer, number)
        waited = [msgpack.unpackb(reader.recv())["n"] for _ in range(publish.QUEUE_FRAMES)]
    assert waited == list(range(read + 1, read + publish.QUEUE_FRAMES + 1))


def test_silence_and_old_frames_are_errors_that_are_also_timeouts(publisher, packer):
    with eitskin.subscribe(publisher.endpoint, timeout_s=60, max_age_s=60.5) as frames:
        wait_until_wanted(publisher)
        send(publisher, packer, 1, age_us=700_000_000)
        with pytest.raises(StaleFrame, match=r"7\d\d\.\d{3} s old, expected at most 60.5 s") as caught:
            next(frames)
        assert isinstance(caught.value, TimeoutError)
        send(publisher, packer, 2)
        assert next(frames).number == 2
    with eitskin.subscribe(publisher.endpoint, timeout_s=0.2) as frames, pytest.raises(NoFrame, match=r"within 0\.2 s"):
        next(frames)


@pytest.mark.parametrize(
    "arguments", [{"mode": "newest"}, {"timeout_s": 0}, {"timeout_s": float("nan")}, {"max_age_s": -1.0}]
)
def test_bad_arguments_of_subscribe_name_the_value(arguments):
    with pytest.raises(ValueError, match=str(next(iter(arguments.values())))):
        eitskin.subscribe("ipc:///tmp/none", **arguments)
