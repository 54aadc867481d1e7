"""TCP beside ipc where few files may be open: libzmq aborts if a connection that it accepts on ipc finds none."""

import socket
import subprocess
import sys
from contextlib import ExitStack, closing
from pathlib import Path

import msgpack
import pytest
import zmq

from eitskin.messaging.admission.promises import Promises
from eitskin.messaging.admission.shutter import Shutter

PATIENCE_S = 60.0

NOBODY_S = 0.3
"""Not a wait for something: that nobody is heard for so long is what is tried. On loopback it takes microseconds."""


def knocks(port, patience_s=PATIENCE_S):
    """Return whether a connection comes about."""
    try:
        socket.create_connection(("127.0.0.1", port), patience_s).close()
    except TimeoutError:
        return False
    return True


def test_a_shut_port_hears_nobody_and_whoever_is_there_is_heard():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with closing(Shutter(port)) as shutter, socket.create_connection(listener.getsockname()) as before:
            accepted, _ = listener.accept()
            with accepted:
                assert shutter.shut()
                assert shutter.shut()
                assert not knocks(port, NOBODY_S)
                before.sendall(b"a")
                assert accepted.recv(1) == b"a"
                accepted.sendall(b"b")
                assert before.recv(1) == b"b"
                shutter.open()
                shutter.open()
                assert knocks(port)


def test_what_cannot_be_shut_is_said():
    with socket.create_server(("127.0.0.1", 0)) as gone:
        port = gone.getsockname()[1]
    shutter = Shutter(port)
    assert not shutter.shut()
    shutter.open()
    shutter.close()
    shutter.close()


def test_tcp_is_shut_until_what_was_promised_on_ipc_is_taken(tmp_path, monkeypatch):
    promises, room = Promises(), "eitskin.messaging.admission.promises.room"
    with socket.create_server(("127.0.0.1", 0)) as tcp, socket.socket(socket.AF_UNIX) as ipc:
        port = tcp.getsockname()[1]
        promises.stranger_came(shutter := Shutter(port))
        monkeypatch.setattr(room, lambda: 1 + shutter.most)
        assert not promises.give(ipc.fileno(), 2)  # so many cannot be had
        assert knocks(port)
        monkeypatch.setattr(room, lambda: 2 + shutter.most)
        ipc.bind(str(tmp_path / "s"))
        ipc.listen()
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(tmp_path / "s"))
            assert promises.give(ipc.fileno(), 2)
            promises.settle()  # it waits still
            assert not knocks(port, NOBODY_S)
            ipc.accept()[0].close()
            promises.settle()
            assert knocks(port)
        promises.stranger_left(shutter)


@pytest.mark.process
def test_a_flood_on_tcp_takes_no_descriptor_of_who_comes_on_ipc(tmp_path):
    program = Path(__file__).with_name("few_files_process.py")
    with (
        subprocess.Popen(
            [sys.executable, program, tmp_path, "64"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as child,
        zmq.Context() as context, context.socket(zmq.DEALER) as client, ExitStack() as stack,
    ):  # fmt: skip
        stack.callback(child.kill)
        port = int(child.stdout.readline())
        client.linger = 0
        client.connect(f"ipc://{tmp_path}/c")
        client.send_multipart([b"", msgpack.packb({"command": "status"})])
        assert child.stdout.readline() == "now\n"
        flood = [stack.enter_context(socket.socket()) for _ in range(100)]
        for one in flood:
            one.setblocking(False)
            one.connect_ex(("127.0.0.1", port))
        files = len(list(Path(f"/proc/{child.pid}/fd").iterdir()))
        knocks(port, NOBODY_S)  # whoever can come has come
        assert len(list(Path(f"/proc/{child.pid}/fd").iterdir())) <= files + 8
        child.stdin.write("\n")
        child.stdin.flush()
        while not client.poll(50):
            assert child.poll() is None, "libzmq has ended the process"
        assert msgpack.unpackb(client.recv_multipart()[1])["ok"]
        for one in flood:
            one.close()
        with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as honest:
            assert honest.recv(1) == b"\xff"  # libzmq's greeting
