"""A subscriber whose connection libzmq ended for good has another soon, whatever it subscribes to."""

import struct
import time
from contextlib import closing
from functools import partial

import pytest

import eitskin
from eitskin.messaging.frame_message import FramePacker
from eitskin.messaging.streams.envelope import FIRST_BYTE
from eitskin.messaging.streams.envelope import packed as enveloped
from eitskin.messaging.streams.verified import TOPIC
from eitskin_proto.skin.skin import PAPER

from ...runtime.messaging.streams.test_bodies import WIRE
from ...runtime.messaging.verified.test_message import MESSAGE
from ..zmtp.host import FRAMES, Host
from ..zmtp.peer import GREETING, packed

EVILS = {
    "100 kB": (packed(bytes(100_000)), GREETING),
    "2^62 bytes announced": (struct.pack(">BQ", 2, 1 << 62), GREETING),
    "no ZMTP": (b"", b"HTTP/1.1 400 Bad Request\r\n\r\n" + bytes(64)),
}


@pytest.fixture(params=["frames", "streams", "verified"])
def kind(request):
    """Return how to subscribe, all topics of that, and a good message."""
    if request.param == "frames":
        packer = FramePacker(configuration="paper/1", bundle="b", serial_number="s", run="r", shape=PAPER.grid.shape)
        packer.put_texts("vd2t", (), ())
        return partial(eitskin.subscribe, mode="all"), FRAMES, bytes(packer.message())
    if request.param == "streams":
        return eitskin.subscribe_streams, [FIRST_BYTE], *enveloped("wire", 1, "r", WIRE.body())
    return partial(eitskin.subscribe_verified, mode="all", frames=False), [TOPIC], MESSAGE


@pytest.mark.parametrize("evil", EVILS)
def test_who_left_for_good_comes_again_and_takes_what_comes_then(kind, evil, tmp_path):
    subscribe, topics, good = kind
    message, greeting = EVILS[evil]

    def serve(stream):
        stream.sendall(packed(good))
        if host.served == 1:
            stream.sendall(message)
            while stream.recv(4096):  # until the subscriber has left
                pass
        while True:
            time.sleep(0.01)
            stream.sendall(packed(good))

    host = Host(str(tmp_path / "f"), serve, greeting, topics)
    with closing(host), subscribe(f"ipc://{tmp_path}/f", timeout_s=60) as found:
        for _ in range(3):  # of the first connection one at most
            next(found)
        assert found.reconnected >= 1
        assert host.served >= 2
