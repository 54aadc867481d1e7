"""Where sockets may be bound, and with which keys: what is taken over, refused, or kept to oneself."""

import stat

import pytest

import eitskin
from eitskin.errors import EndpointError
from eitskin.messaging.endpoints import default_control, needs_keys, runtime_folder
from eitskin.messaging.publish import Publisher

from .publishing import send, wait_until_wanted


def test_the_default_folder_is_private_and_a_shared_one_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert stat.S_IMODE(runtime_folder().stat().st_mode) == 0o700
    assert default_control() == f"ipc://{tmp_path}/eitskin/control"
    (tmp_path / "eitskin").chmod(0o755)
    with pytest.raises(EndpointError, match="not a private folder"):
        runtime_folder()
    (tmp_path / "eitskin").rmdir()
    (tmp_path / "eitskin").symlink_to("/tmp")
    with pytest.raises(EndpointError):
        runtime_folder()


def test_an_address_in_use_is_named_and_its_owner_is_not_disturbed(publisher, packer):
    with pytest.raises(EndpointError, match=r"frames is in use: stop the program"):
        Publisher(publisher.endpoint)
    with eitskin.subscribe(publisher.endpoint, timeout_s=60) as frames:
        wait_until_wanted(publisher)
        send(publisher, packer, 4)
        assert next(frames).number == 4


def test_a_dead_socket_is_taken_over_and_any_other_file_is_left_alone(tmp_path):
    import socket

    path = tmp_path / "frames"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    publisher = Publisher(f"ipc://{path}")
    assert stat.S_ISSOCK(path.stat().st_mode)
    publisher.close()
    publisher.close()
    assert not path.exists()
    path.write_text("precious")
    with pytest.raises(EndpointError, match="another file is in the way"):
        Publisher(f"ipc://{path}")
    assert path.read_text() == "precious"
    with pytest.raises(EndpointError, match="folder does not exist"):
        Publisher(f"ipc://{tmp_path}/none/frames")


@pytest.mark.parametrize("endpoint", ["tcp://127.0.0.1:*", "tcp://[::1]:5555", "tcp://0.0.0.0:5555", "tcp://eth0:5555"])
def test_tcp_is_refused_without_keys_on_this_machine_too(endpoint):
    assert needs_keys(endpoint)
    with pytest.raises(EndpointError, match=r"--curve-keys DIR.*doctor --make-curve-keys.*or use ipc:///path"):
        Publisher(endpoint)
    with pytest.raises(EndpointError, match="needs CURVE keys, even on this machine: give --server-key FILE"):
        eitskin.subscribe(endpoint)
    assert not needs_keys("ipc:///tmp/x")


@pytest.mark.parametrize(
    "endpoint",
    ["", "frames", "inproc://x", "udp://1.2.3.4:5", "ipc://@abstract", "ipc://relative", "tcp://127.0.0.1",
     "tcp://127.0.0.1:99999", "tcp://:5", "ipc:///" + "x" * 200, "ipc:///tmp/\udcff"],
)  # fmt: skip
def test_other_endpoints_are_refused(endpoint):
    with pytest.raises(EndpointError):
        Publisher(endpoint)
