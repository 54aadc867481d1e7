"""How tests publish a frame, and wait until somebody takes them."""

import time

from eitskin.messaging.frame import EVERY_FRAME


def send(publisher, packer, number, age_us=100):
    packer.put("n", number)
    packer.put("seq", number)
    packer.put("age_us", age_us)
    packer.put("publish", time.perf_counter_ns())
    publisher.look()
    publisher.send(packer.message())


def wait_until_wanted(publisher, subscribers=1):
    """Wait for subscribers to every frame."""
    end = time.perf_counter() + 60
    while (EVERY_FRAME not in publisher.topics or publisher.subscribers < subscribers) and time.perf_counter() < end:
        publisher.look()
        time.sleep(0.005)
    assert publisher.wanted
    assert publisher.subscribers >= subscribers


def wait_for(publisher, condition):
    """Wait until a condition holds, while the publisher looks who subscribes."""
    end = time.perf_counter() + 60
    while not condition() and time.perf_counter() < end:
        publisher.look()
        time.sleep(0.002)
    assert condition()
