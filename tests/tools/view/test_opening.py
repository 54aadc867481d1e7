"""The address that the commands print, its token, and when a browser is opened at it."""

import contextlib
import http.client
import signal
import sys
import webbrowser
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

from eitskin_tools import cli
from eitskin_tools.commands import view

from .conftest import started

TTY, DISPLAY, WAYLAND = "a terminal", "DISPLAY", "WAYLAND_DISPLAY"
SEATS = [
    ({TTY, DISPLAY}, True),
    ({TTY, WAYLAND}, True),
    ({TTY}, False),
    ({DISPLAY, WAYLAND}, False),
]
"""What there is, and whether somebody sits there who would see a browser."""


@pytest.fixture
def opened(monkeypatch):
    """Return the list of what is opened in a browser from now on."""
    found = []
    monkeypatch.setattr(webbrowser, "open", found.append)
    return found


@pytest.fixture
def sit(monkeypatch):
    """Return what makes a stream and the environment be those of a seat."""

    def made(stream, seat):
        monkeypatch.setattr(stream, "isatty", lambda: TTY in seat)
        for name in (DISPLAY, WAYLAND):
            if name in seat:
                monkeypatch.setenv(name, ":7")
            else:
                monkeypatch.delenv(name, raising=False)

    return made


@pytest.fixture
def handlers():
    """Signals are handled afterwards as before."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


class CtrlC:
    """What the command waits for in the end: here Ctrl-C comes just before a wait, and is heard after it."""

    def __init__(self):
        self.waits = 0

    def wait(self, timeout_s):
        self.waits += 1
        if self.waits == 2:
            raise KeyboardInterrupt
        assert timeout_s <= 1.0
        return False


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize(
    ("words", "seat", "seen"),
    [
        *[([], seat, seen) for seat, seen in SEATS],
        (["--token"], {TTY, DISPLAY}, True),
        (["--no-open"], {TTY, DISPLAY, WAYLAND}, False),
    ],
)
def test_view_opens_the_address_that_it_prints_where_a_browser_would_be_seen(
    endpoint, monkeypatch, capsys, opened, sit, words, seat, seen
):
    sit(sys.stdout, seat)
    monkeypatch.setattr(view, "threading", SimpleNamespace(Event=CtrlC))
    assert cli.main(["view", "--endpoint", endpoint, "--port", "0", *words]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith(f"viewing {endpoint} at http://127.0.0.1:")
    assert out.endswith(" until Ctrl-C\n")
    address = out.split()[3]
    assert "#token=" in address
    assert opened == ([address] if seen else [])


def asked(port, path, token=None):
    """Return the status of a request on this machine."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    with contextlib.closing(connection):
        connection.request("GET", path, headers={} if token is None else {"Authorization": f"Bearer {token}"})
        with connection.getresponse() as answer:
            return answer.status


@pytest.mark.process
@pytest.mark.parametrize("words", [["--host", "0.0.0.0"], []])
def test_the_stream_wants_the_token_of_the_address_and_each_start_has_another_one(endpoint, words):
    tokens = []
    for _ in range(2):
        with started("view", "--endpoint", endpoint, "--port", 0, "--no-open", *words, until="viewing") as line:
            address = urlsplit(next(word for word in line.split() if word.startswith("http://")))
            name, _, token = address.fragment.partition("=")
            assert (name, address.path) == ("token", "/")
            assert len(token) >= 22, "128 bits"
            assert asked(address.port, "/") == 200, "the page itself holds no secret"
            for wrong in (None, "", token[:-1], *tokens):
                assert asked(address.port, "/stream", wrong) == 401
            assert asked(address.port, "/stream", token) == 200
            tokens.append(token)
    assert len(set(tokens)) == 2
