"""Who is served first: libzmq goes from the shortest prefix to the longest, so robots come before those who look on."""

import select
import socket
import time

import pytest

import eitskin
from eitskin.messaging import subscription
from eitskin.messaging.frame import EVERY_FRAME, FIRST_BYTE, KEYS, TOUCH_FIRST_BYTE, patient_topics, unpack_frame
from eitskin.messaging.publish import Publisher
from eitskin.messaging.regions import ALWAYS, UNCHANGED, WHOLE, Region
from eitskin_proto.skin.skin import PAPER

from ..publishing import send, wait_for

ROUNDS = 40
PATIENT = patient_topics(FIRST_BYTE)
TOUCHED = b"", b"", 0


def packed(body, flags=0):
    return bytes([flags, len(body)]) + body


class Raw:
    """A subscriber of bare sockets: the kernel says when its bytes came, whoever runs meanwhile."""

    def __init__(self, endpoint, topics):
        scheme, _, rest = endpoint.partition("://")
        self.stream = socket.socket(socket.AF_UNIX if scheme == "ipc" else socket.AF_INET)
        host, _, port = rest.rpartition(":")
        self.stream.connect(rest if scheme == "ipc" else (host, int(port)))
        self.stream.setblocking(False)
        self.stream.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(48))
        self.stream.sendall(packed(b"\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB", 4))
        self.said, self.received = topics, b""

    def ready(self):
        """Go on with the handshake; True once everything is asked for."""
        self.take()
        if self.said and len(self.received) > 66 and len(self.received) >= 66 + self.received[65]:
            self.stream.sendall(b"".join(packed(b"\x01" + topic) for topic in self.said))
            self.said, self.received = (), b""
        return not self.said

    def take(self):
        try:
            while came := self.stream.recv(1 << 16):
                self.received += came
        except BlockingIOError:
            return len(self.received)


def test_robots_are_served_before_those_who_look_on_whoever_came_first(tmp_path, packer):
    said = {"patient": (WHOLE, ALWAYS, *PATIENT), "robot": (EVERY_FRAME,), "region": (WHOLE, ALWAYS, FIRST_BYTE)}
    publisher = Publisher(f"ipc://{tmp_path}/frames")
    here, orders = {}, []
    try:
        for name, topics in said.items():
            here[name] = Raw(publisher.endpoint, topics)
            wait_for(publisher, lambda name=name, last=topics[-1]: here[name].ready() and last in publisher.topics)
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
            one.stream.close()
        publisher.close()
    assert orders.count(["region", "robot", "patient"]) > 0.75 * ROUNDS  # its thread may still be at the one before


@pytest.mark.parametrize("touched", [False, True])
def test_every_message_that_is_packed_is_one_that_the_patient_get(packer, touched):
    packer.put_touches(TOUCHED if touched else None)
    assert bytes(packer.message()[:3]) in PATIENT
    assert bytes(packer.short_message()[:3]) in PATIENT
    alone = patient_topics(TOUCH_FIRST_BYTE)
    assert packer.touch_message().startswith(alone)
    assert len(PATIENT) == len(alone) == len(KEYS)


def test_the_patient_say_what_they_need_as_others_do(publisher):
    region = {"region_mm": (0.0, 0.0, 10.0, 10.0), "skip_unchanged": True}
    with eitskin.subscribe(publisher.endpoint, patient=True, **region) as looking_on:
        wait_for(publisher, lambda: set(PATIENT) <= set(publisher.topics))
        assert publisher.wanted
        assert looking_on.region == Region(0, 3, 0, 3)
        assert publisher.takes_short
        with eitskin.subscribe(publisher.endpoint, patient=True) as everything:
            wait_for(publisher, lambda: publisher.subscribers == 2)
            assert not publisher.takes_short
            assert everything.region.slices[0].stop >= PAPER.grid.shape[0]
        wait_for(publisher, lambda: publisher.takes_short)
        with eitskin.subscribe(publisher.endpoint):  # a robot as ever
            wait_for(publisher, lambda: EVERY_FRAME in publisher.topics)
            assert not publisher.takes_short
    wait_for(publisher, lambda: not publisher.wanted)


def test_of_touches_alone_the_patient_come_last_too(publisher, packer):
    packer.put_touches(TOUCHED)
    with eitskin.subscribe(publisher.endpoint, maps=False, patient=True, timeout_s=60) as touches:
        wait_for(publisher, lambda: publisher.topics == set(patient_topics(TOUCH_FIRST_BYTE)))
        assert (publisher.asked.frames, publisher.asked.alone) == (False, True)
        publisher.send(memoryview(packer.touch_message()))
        assert next(touches).touches == ()


def test_the_newest_frame_is_the_only_one_that_is_read(publisher, packer, monkeypatch):
    read = []

    def noted(message, *arguments):
        read.append(unpack_frame(message, *arguments))
        return read[-1]

    monkeypatch.setattr(subscription, "unpack_frame", noted)
    with eitskin.subscribe(publisher.endpoint, patient=True, timeout_s=60) as newest:
        wait_for(publisher, lambda: set(PATIENT) <= set(publisher.topics))
        for number in range(1, 21):
            send(publisher, packer, number)
        end = time.perf_counter() + 60
        while not read or read[-1].number < 20:
            assert time.perf_counter() < end
            time.sleep(0.05)
            newest.next_frame()
    assert len(read) == newest.received < 20
    assert newest.received + newest.lost >= read[-1].number - read[0].number


def test_unchanged_maps_come_from_frames_that_were_passed_over(publisher, packer):
    with eitskin.subscribe(publisher.endpoint, patient=True, skip_unchanged=True, timeout_s=60) as newest:
        wait_for(publisher, lambda: UNCHANGED in publisher.topics and set(PATIENT) <= set(publisher.topics))
        packer.put("map_seq", 1)
        send(publisher, packer, 1)
        packer.put("n", 2)
        publisher.send(packer.short_message())
        frame = newest.next_frame()
        while frame.number < 2:
            frame = newest.next_frame()
        assert frame.map.shape == PAPER.grid.shape
        assert newest.mapless == 0
