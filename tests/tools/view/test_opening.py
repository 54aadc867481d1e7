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


@pytest.mark.parametrize(
    ("terminal", "display", "words", "seen"),
    [
        (True, "DISPLAY", [], True),
        (True, "WAYLAND_DISPLAY", [], True),
        (True, "DISPLAY", ["--no-open"], False),
        (True, "NO_DISPLAY", [], False),
        (False, "DISPLAY", [], False),
    ],
)
def test_view_opens_the_address_that_it_prints_where_a_browser_would_be_seen(
    endpoint, monkeypatch, capsys, terminal, display, words, seen
):
    opened = []

    def ctrl_c(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv(display, ":7")
    monkeypatch.setattr(view, "threading", SimpleNamespace(Event=lambda: SimpleNamespace(wait=ctrl_c)))
    monkeypatch.setattr(signal, "signal", lambda *_: None)
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
