"""A folder of keys: who could have put a key there, and what a damaged one costs."""

import os
from pathlib import Path

import pytest

from eitskin.errors import ControlError, EndpointError
from eitskin.messaging import curve_keys
from eitskin.messaging.control import ControlServer
from eitskin.messaging.control_client import request
from eitskin.messaging.curve_keys import load_client_keys, load_server_keys, make_keys


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


def test_damaged_keys_are_named_and_the_others_enter(keys, tmp_path, recorder):
    clients = keys / "clients"
    (clients / "empty.key").touch(0o600)
    (clients / "noise.key").write_bytes(bytes(range(256)))
    (clients / "short.key").write_text('public-key = "abc"')
    (clients / "no z85.key").write_text('public-key = "' + "~" * 40 + '"')
    (clients / "endless.key").symlink_to("/dev/zero")
    os.mkfifo(clients / "fifo.key", 0o600)
    (clients / "gone.key").symlink_to("nowhere")
    (clients / "folder.key").mkdir()
    (clients / "readme.txt").write_text("no key, and none is expected")
    for path in clients.iterdir():
        if path.is_file() and not path.is_symlink():
            path.chmod(0o600)
    found = load_server_keys(keys)
    assert len(found.admitted) == 1
    assert len(found.damaged) == 8
    assert all("is left out: " in line and "\n" not in line for line in found.damaged)
    make_keys(tmp_path / "other")
    server = ControlServer("tcp://127.0.0.1:*", recorder, found)
    try:
        trusted = load_client_keys(keys / "server.key", keys / "client.key_secret")
        assert request(server.endpoint, "status", keys=trusted, timeout_s=60) == {"frames": 5}
        (clients / "later.key").write_text("damaged while it runs")
        assert request(server.endpoint, "status", keys=trusted, timeout_s=60) == {"frames": 5}
        stranger = load_client_keys(keys / "server.key", tmp_path / "other" / "client.key_secret")
        with pytest.raises(ControlError, match="no answer"):
            request(server.endpoint, "status", keys=stranger, timeout_s=0.3)
    finally:
        server.close()


def test_a_folder_of_damaged_keys_alone_admits_nobody_and_is_refused(keys):
    (keys / "clients" / "client.key").write_text("?")
    with pytest.raises(EndpointError, match=r"client.key is left out: it holds no public key.*no client could connect"):
        load_server_keys(keys)


def test_more_keys_than_anybody_has_clients_are_refused(keys, monkeypatch):
    monkeypatch.setattr(curve_keys, "MOST_FILES", 20)
    for number in range(100):
        (keys / "clients" / f"{number}.key").touch()
    with pytest.raises(EndpointError, match="holds more than 20 files; remove"):
        load_server_keys(keys)


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
