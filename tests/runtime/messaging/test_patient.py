"""Who is served first: libzmq goes from the shortest prefix to the longest, so robots come before those who look on."""

import select
import time

from eitskin.messaging.frame import EVERY_FRAME, FIRST_BYTE, patient_topics
from eitskin.messaging.regions import ALWAYS, WHOLE

from .publishing import Peer, send, wait_for

ROUNDS = 40
PATIENT = patient_topics(FIRST_BYTE)


def test_robots_are_served_before_patient_subscribers_in_any_order_of_arrival(publisher, packer):
    said = {"patient": (WHOLE, ALWAYS, *PATIENT), "robot": (EVERY_FRAME,), "region": (WHOLE, ALWAYS, FIRST_BYTE)}
    here, orders = {}, []
    try:
        for name, topics in said.items():
            here[name] = Peer(publisher)
            here[name].subscribe(*topics)
            wait_for(publisher, lambda last=topics[-1]: last in publisher.topics)
        size = len(packer.message()) + 9
        for number in range(1, ROUNDS + 1):
            with select.epoll() as came:  # of what happens once, it tells in the order in which it happened
                for one in here.values():
                    came.register(one.stream, select.EPOLLIN | select.EPOLLET)
                send(publisher, packer, number)
                first, end = [], time.perf_counter() + 60
                while len(first) < len(here) and time.perf_counter() < end:
                    first += [found for found, _ in came.poll(1.0) if found not in first]
            wait_for(publisher, lambda: all(one.take() == size for one in here.values()))
            orders.append([name for found in first for name, one in here.items() if one.stream.fileno() == found])
            for one in here.values():
                one.received = b""
    finally:
        for one in here.values():
            one.close()
    assert orders.count(["region", "robot", "patient"]) > 0.75 * ROUNDS  # its thread may still be at the one before
