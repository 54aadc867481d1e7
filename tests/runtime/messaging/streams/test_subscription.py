"""Streams from a publisher to subscribers: only what is asked for, numbered, and nothing taken from anybody else."""

import msgpack
import pytest

import eitskin
from eitskin.errors import NoFrame
from eitskin.messaging.streams.envelope import NAMES

from ..publishing import wait_for
from .test_bodies import CLOUD, CONDITIONS, STATE, WIRE

ITEMS = {"wire": WIRE, "cloud": CLOUD, "conditions": CONDITIONS, "state": STATE}


@pytest.fixture
def sending(publisher):
    publisher.streams.run = "r"
    return publisher.streams


def asked(sending):
    return {name for name in NAMES if getattr(sending, name)}


def wait_until_asked(publisher, names):
    wait_for(publisher, lambda: asked(publisher.streams) == set(names))


@pytest.mark.parametrize(
    ("wishes", "names"),
    [
        ({}, NAMES),
        ({"wire": False}, ("cloud", "state")),
        ({"clouds": False, "state": False}, ("wire", "conditions")),
        ({"wire": False, "clouds": False}, ("state",)),
        ({"conditions": False, "state": False}, ("wire", "cloud")),
    ],
)
def test_what_is_asked_for_comes_and_nothing_else(publisher, sending, wishes, names):
    assert not sending.asked
    with eitskin.subscribe_streams(publisher.endpoint, timeout_s=60, **wishes) as streams:
        wait_until_asked(publisher, names)
        assert sending.asked
        assert sending.joined
        assert not publisher.wanted
        for name in NAMES:
            sending.send(name, ITEMS[name].body())
        found = [next(streams) for _ in names]
        assert {type(item) for item in found} == {type(ITEMS[name]) for name in names}
        assert {(item.n, item.run) for item in found} == {(1, "r")}
        assert all(item.received_ns > 0 for item in found)
        sending.send(names[0], ITEMS[names[0]].body())
        assert next(streams).n == 2
        assert streams.received == len(names) + 1
    wait_for(publisher, lambda: not sending.asked)


def test_a_gap_in_thenumbers_is_counted_and_a_new_run_is_none(publisher, sending):
    with eitskin.subscribe_streams(publisher.endpoint, timeout_s=60, clouds=False, state=False) as streams:
        wait_until_asked(publisher, ("wire", "conditions"))
        for number in (1, 2, 5, 6):
            sending.numbers["wire"] = number - 1
            sending.send("wire", WIRE.body())
        assert [next(streams).n for _ in range(4)] == [1, 2, 5, 6]
        assert streams.lost["wire"] == 2
        sending.run, sending.numbers["wire"] = "another", 40
        sending.send("wire", WIRE.body())
        assert next(streams).run == "another"
        assert streams.lost["wire"] == 2


def test_a_subscriber_that_does_not_read_loses_messages_and_sees_how_many(publisher, sending):
    with eitskin.subscribe_streams(publisher.endpoint, timeout_s=60, clouds=False, state=False) as streams:
        wait_until_asked(publisher, ("wire", "conditions"))
        big = msgpack.packb(msgpack.unpackb(WIRE.body()) | {"filling": bytes(60_000)})
        most = 12_000
        for _ in range(most):
            sending.send("wire", big)
        assert publisher.dropped == 0  # the socket takes it, and leaves it out for who is slow
        numbers = []
        while not numbers or numbers[-1] < most:
            try:
                numbers.append(streams.next_item(1.0).n)
            except NoFrame:
                sending.send("wire", big)
                most += 1
        assert streams.lost["wire"] == numbers[-1] - len(numbers) > 0


def test_who_comes_later_makes_all_be_told_again(publisher, sending):
    with eitskin.subscribe_streams(publisher.endpoint, timeout_s=60):
        wait_until_asked(publisher, NAMES)
        sending.joined = False
        with eitskin.subscribe_streams(publisher.endpoint, timeout_s=60):
            wait_for(publisher, lambda: sending.joined)
