"""Fixtures of the messaging tests: a control server that only remembers, a publisher and what packs its frames."""

import msgpack
import pytest
import zmq

from eitskin.messaging.control import ControlServer
from eitskin.messaging.curve_keys import make_keys
from eitskin.messaging.frame_message import FramePacker
from eitskin.messaging.publish import Publisher
from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_proto.skin.skin import PAPER


class Recorder:
    """A runtime that only remembers what it was asked."""

    def __init__(self):
        self.clouds, self.stopped = [], False

    def use_cloud(self, cloud, predicted=None, predicted_flat=None):
        doubts = check_sheet(cloud)[1]
        self.clouds.append((cloud, predicted, predicted_flat))
        return len(self.clouds), doubts

    def recapture(self, frames, *, force=False):
        self.forced = force
        return {"frames": frames, "weak_rows": []}

    def exclude(self, electrodes):
        if 15 in electrodes:
            raise ValueError("15 is taken for missing here")
        self.excluded = electrodes

    def status(self):
        return {"frames": 5}

    def stop(self):
        self.stopped = True


@pytest.fixture
def recorder():
    return Recorder()


@pytest.fixture
def server(tmp_path, recorder):
    server = ControlServer(f"ipc://{tmp_path}/control", recorder)
    yield server
    server.close()
    server.close()


@pytest.fixture
def raw(server):
    """Return a function that sends any bytes as a request and gives the answer."""
    context = zmq.Context()

    def ask(*parts):
        socket = context.socket(zmq.REQ)
        socket.linger = 0
        socket.connect(server.endpoint)
        socket.send_multipart(parts)
        answer = msgpack.unpackb(socket.recv()) if socket.poll(60_000) else None
        socket.close()
        return answer

    yield ask
    context.destroy(0)


@pytest.fixture
def packer():
    packer = FramePacker(configuration="paper/1", bundle="b", serial_number="s", run="r", shape=PAPER.grid.shape)
    packer.put_texts("vd2t", (), ())
    return packer


@pytest.fixture
def publisher(tmp_path):
    publisher = Publisher(f"ipc://{tmp_path}/frames")
    yield publisher
    publisher.close()


@pytest.fixture
def keys(tmp_path):
    make_keys(tmp_path / "keys")
    return tmp_path / "keys"
