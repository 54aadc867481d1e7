"""Subscriptions of every kind end quietly, whichever thread stops or closes them and whenever."""

import asyncio
import copy
import pickle
import random
import threading
import time

import pytest

import eitskin
from eitskin.errors import Closed
from eitskin.messaging.frame import unpack_frame
from eitskin.messaging.streams import verified_subscription

from .publishing import send

ROUNDS, AT_ONCE = 20, 10


@pytest.fixture
def published(publisher, packer):
    """The endpoint of a publisher that sends frames from a thread."""
    ended = threading.Event()

    def publish():
        number = 0
        while not ended.wait(0.001):
            send(publisher, packer, number := number + 1)

    thread = threading.Thread(target=publish)
    thread.start()
    yield publisher.endpoint
    ended.set()
    thread.join()


@pytest.fixture
def kinds(published, tmp_path):
    """{name: a function that opens a subscription}; frames come to the first and the last only."""
    text = 'format = "eitskin-robot"\nversion = 1\n'
    text += f'[[skins]]\nname = "left"\nport = "/dev/l"\npublish = "{published}"\n'
    (tmp_path / "robot.toml").write_text(text)
    return {
        "frames": lambda: eitskin.subscribe(published),
        "streams": lambda: eitskin.subscribe_streams(published),
        "verified": lambda: eitskin.subscribe_verified(published),
        "all": lambda: eitskin.subscribe_all(tmp_path / "robot.toml"),
    }


KINDS = ["frames", "streams", "verified", "all"]


def test_two_hundred_closes_at_random_moments_end_iteration_and_nothing_else(kinds):
    chance, wrong = random.Random(0), []

    def read(items):
        try:
            for _ in items:
                pass
        except Exception as error:
            wrong.append(error)

    for _ in range(ROUNDS):
        opened = [kinds[chance.choice(KINDS)]() for _ in range(AT_ONCE)]
        threads = [threading.Thread(target=read, args=(items,)) for items in opened]
        for thread in threads:
            thread.start()
        for items in opened:
            time.sleep(chance.uniform(0, 0.01))
            chance.choice([items.close, items.stop])()
        for thread in threads:
            thread.join(60)
            assert not thread.is_alive()
        for items in opened:
            items.close()
    assert not wrong


@pytest.mark.parametrize("kind", KINDS)
def test_after_stop_or_close_the_root_of_the_error_is_skin_error(kinds, kind):
    items = kinds[kind]()
    wait = getattr(items, {"streams": "next_item", "verified": "next_verified"}.get(kind, "next_frame"))
    items.stop()
    assert list(items) == []
    items.close()
    items.close()
    assert list(items) == []
    with pytest.raises(eitskin.SkinError, match="stopped or closed") as caught:
        wait()
    assert caught.type is Closed


@pytest.mark.parametrize("kind", KINDS)
def test_pickling_and_copying_are_refused_in_a_line(kinds, kind):
    with kinds[kind]() as items:
        for attempt in (pickle.dumps, copy.copy):
            with pytest.raises(TypeError, match=r"connection of this process.* subscribe in the other one"):
                attempt(items)


def test_asyncio_receives_frames_beside_other_tasks_and_ends_when_cancelled(published):
    async def main():
        numbers = []

        async def receive():
            async for frame in eitskin.subscribe_async(published, mode="all"):
                numbers.append(frame.number)  # noqa: PERF401 -- the outer loop watches the list grow

        task = asyncio.create_task(receive())
        while len(numbers) < 5:
            await asyncio.sleep(0.001)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        async for frame in eitskin.subscribe_async(published):
            return numbers, frame

    numbers, frame = asyncio.run(main())
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert frame.number > numbers[-1]


def test_a_reader_that_is_slower_than_its_publisher_ends_too(monkeypatch, published):
    begun = threading.Event()

    def unpack(*message):
        begun.set()
        time.sleep(0.01)  # a frame comes each millisecond
        return unpack_frame(*message)

    monkeypatch.setattr(verified_subscription, "unpack_frame", unpack)
    items = eitskin.subscribe_verified(published)
    thread = threading.Thread(target=list, args=(items,))
    thread.start()
    assert begun.wait(60)
    items.close()
    thread.join(60)
    assert not thread.is_alive()
