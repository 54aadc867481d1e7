"""A folder of keys: who could have put a key there, and what a damaged one costs."""

import os
from pathlib import Path

import pytest

import eitskin
from eitskin.errors import ControlError, EndpointError, NoFrame
from eitskin.messaging.control import ControlServer
from eitskin.messaging.control_client import request
from eitskin.messaging.curve_keys import load_client_keys, load_server_keys, make_keys
from eitskin.messaging.publish import Publisher

from .publishing import send, wait_until_wanted


@pytest.mark.parametrize("name", [".", "clients", "clients/client.key", "server.key_secret"])
@pytest.mark.parametrize("others", [0o002, 0o020])
def test_what_others_can_write_to_is_refused_with_the_command_that_helps(keys, name, others):
    path = keys / name
    load_server_keys(keys)
    path.chmod(path.stat().st_mode | others)
    with pytest.raises(EndpointError, match=r"run: chmod (go-w|600) ") as found:
        load_server_keys(keys)
    _, mode, named = str(found.value).rpartition("run: ")[2].split(" ", 2)
    Path(named).chmod(0o600 if mode == "600" else Path(named).stat().st_mode & ~0o022)  # what the command does
    load_server_keys(keys)


def test_what_belongs_to_another_user_is_refused(keys, monkeypatch):
    owner = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    if owner == 0:  # what root put there is trusted
        load_server_keys(keys)
        for path in (keys / "clients" / "client.key", keys / "clients", keys):
            os.chown(path, 12345, -1)
            with pytest.raises(EndpointError, match=r"belongs to another user \(number 12345\).*sudo chown 1 "):
                load_server_keys(keys)
    else:
        with pytest.raises(EndpointError, match=f"another user .number {owner}.*sudo chown {owner + 1} "):
            load_server_keys(keys)


DAMAGED = {
    "empty": lambda path: path.touch(0o600),
    "noise": lambda path: path.write_bytes(bytes(range(256))),
    "short": lambda path: path.write_text('public-key = "abc"'),
    "no z85": lambda path: path.write_text('public-key = "' + "~" * 40 + '"'),
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "fifo": lambda path: os.mkfifo(path, 0o600),
    "gone": lambda path: path.symlink_to("nowhere"),
    "folder": lambda path: path.mkdir(),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_key_is_refused_by_its_name(keys, name):
    path = keys / "clients" / "other.key"
    DAMAGED[name](path)
    with pytest.raises(EndpointError, match=f"{path} is not a CURVE key") as found:
        load_server_keys(keys)
    assert "\n" not in str(found.value)


def test_who_has_a_listed_key_enters_and_nobody_else(keys, tmp_path, recorder, packer):
    (keys / "clients" / "readme.txt").write_text("no key, and none is expected")
    make_keys(tmp_path / "other")
    server = ControlServer("tcp://127.0.0.1:*", recorder, load_server_keys(keys))
    publisher = Publisher("tcp://127.0.0.1:*", load_server_keys(keys))
    try:
        trusted = load_client_keys(keys / "server.key", keys / "client.key_secret")
        assert request(server.endpoint, "status", keys=trusted, timeout_s=60) == {"frames": 5}
        (keys / "clients" / "later.key").write_text("damaged while it runs")
        assert request(server.endpoint, "status", keys=trusted, timeout_s=60) == {"frames": 5}
        stranger = load_client_keys(keys / "server.key", tmp_path / "other" / "client.key_secret")
        with pytest.raises(ControlError, match="no answer"):
            request(server.endpoint, "status", keys=stranger, timeout_s=0.3)
        with eitskin.subscribe(publisher.endpoint, keys=stranger, timeout_s=0.3) as nothing:
            with eitskin.subscribe(publisher.endpoint, keys=trusted, timeout_s=60) as frames:
                wait_until_wanted(publisher)
                send(publisher, packer, 9)
                assert next(frames).number == 9
            with pytest.raises(NoFrame):
                next(nothing)
    finally:
        publisher.close()
        server.close()


@pytest.mark.parametrize(
    "name", ["server.key", "server.key_secret", "client.key", "client.key_secret", "clients/client.key"]
)
def test_keys_are_made_over_nothing_that_is_there(name, tmp_path):
    path = tmp_path / "keys" / name
    path.parent.mkdir(parents=True)
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(EndpointError, match=f"already holds keys, {path}: name another folder"):
        make_keys(tmp_path / "keys")
    assert path.is_symlink()
    assert not (tmp_path / "elsewhere").exists()
