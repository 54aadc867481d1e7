import http.client
import socket
import threading

import pytest
from tests.tools.view.unpacking import unpacked

from eitskin_tools.view import board as board_module
from eitskin_tools.view import server as server_module
from eitskin_tools.view.board import Board
from eitskin_tools.view.messages import packed, status_message
from eitskin_tools.view.server import PortUnavailable, ViewServer, host_allowed, is_loopback, page_address, pages


class Remembering:
    def __init__(self):
        self.done = []

    def start(self):
        self.done.append("start")
        return ""

    def stop(self):
        self.done.append("stop")
        return ""


@pytest.fixture
def serve():
    """Return a maker of running servers."""
    running = []

    def make(token="", **more):
        server = ViewServer("127.0.0.1", 0, Board(), token, **more)
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        running.append((server, thread))
        return server

    yield make
    for server, thread in running:
        server.board.close()
        server.shutdown()
        thread.join()
        server.server_close()


def ask(server, path="/", method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
    named = {"Host": f"127.0.0.1:{server.port}"} | {name.replace("_", "-"): value for name, value in headers.items()}
    connection.putrequest(method, path, skip_host=True)
    for name, value in named.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    return answer, connection


def status(server, *arguments, **headers):
    answer, connection = ask(server, *arguments, **headers)
    text = answer.read()
    connection.close()
    return answer.status, text


def test_the_pages_files_are_served_with_a_policy_that_allows_nothing_else(serve):
    server = serve()
    for path, (kind, body) in pages().items():
        answer, connection = ask(server, path)
        assert (answer.status, answer.read(), answer.headers["Content-Type"]) == (200, body, kind)
        assert answer.headers["Content-Security-Policy"].startswith("default-src 'none'")
        assert "unsafe" not in answer.headers["Content-Security-Policy"]
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        connection.close()
    assert {"/", "/main.js", "/style.css"} <= set(pages())


def test_the_page_names_no_file_that_is_not_served_and_none_of_another_site():
    for path, (kind, body) in pages().items():
        text = body.decode()
        assert "://" not in text.replace("http://www.w3.org/2000/svg", ""), path
        if kind.startswith("text/javascript"):
            named = [line.rpartition('from "./')[2].rstrip('";') for line in text.splitlines() if 'from "./' in line]
            assert {f"/{name}" for name in named} <= set(pages()), path


@pytest.mark.parametrize("path", ["/../server.py", "/index.html", "/stream/", "/%2e%2e/feed.py", "/main.js?x"])
def test_any_other_path_is_not_there(serve, path):
    assert status(serve(), path)[0] == 404


@pytest.mark.parametrize("method", ["PUT", "DELETE", "OPTIONS", "HEAD", "TRACE", "BREW"])
def test_any_other_method_is_refused_in_one_line(serve, method):
    code, text = status(serve(), "/", method)
    assert code == 501
    assert text.count(b"\n") <= 1
    assert b"<" not in text


def test_a_request_that_names_another_host_is_refused(serve):
    server = serve()
    port = server.port
    for host in (
        "evil.example",
        f"evil.example:{port}",
        "",
        f"10.0.0.1:{port}",
        f"proxy.example:{port}",
        "notlocalhost",
    ):
        assert status(server, Host=host)[0] == 421, host
    for host in (
        f"127.0.0.1:{port}",
        f"localhost:{port}",
        f"LOCALHOST:{port}",
        f"[::1]:{port}",
        "127.0.0.1",
        "localhost:9000",
        "skin.localhost:9000",
    ):
        assert status(server, Host=host)[0] == 200, host
    assert status(serve(allowed=["Proxy.example"]), Host="proxy.example:443")[0] == 200


def test_beyond_loopback_a_name_of_a_site_is_refused_and_an_address_is_not():
    assert host_allowed("192.168.1.7:80", "0.0.0.0")
    assert host_allowed("[fe80::1]:80", "::")
    assert host_allowed(f"{socket.gethostname()}:80", "0.0.0.0")
    assert not host_allowed("evil.example:80", "0.0.0.0")
    assert not host_allowed("192.168.1.7.evil.example:80", "0.0.0.0")


def test_a_page_of_another_site_gets_nothing(serve):
    server = serve()
    assert status(server, "/", Sec_Fetch_Site="cross-site")[0] == 403
    assert status(server, "/stream", Sec_Fetch_Site="same-site")[0] == 403
    assert status(server, "/main.js", Sec_Fetch_Site="same-origin")[0] == 200


def test_a_name_is_of_this_machine_or_of_others():
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "10.0.0.1", "name")] == [
        True, True, True, False, False, False,
    ]  # fmt: skip
    assert page_address("::1", 80, "t") == "http://[::1]:80/#token=t"


def test_a_port_in_use_is_told_in_one_line(serve):
    port = serve().port
    with pytest.raises(PortUnavailable, match=f"port {port} of 127.0.0.1 is in use.*--port"):
        ViewServer("127.0.0.1", port, Board())


def test_only_the_page_itself_starts_a_recording(serve):
    recorder = Remembering()
    server = serve("t", recorder=recorder)
    own = f"http://127.0.0.1:{server.port}"
    assert status(server, "/record/start", "POST")[0] == 403
    assert status(server, "/record/start", "POST", Origin="http://evil.example")[0] == 403
    assert status(server, "/record/start", "POST", Origin=own)[0] == 401
    assert status(server, "/record/start", "POST", Origin=own, Authorization="Bearer t", Content_Length="5")[0] == 413
    assert recorder.done == []
    assert status(server, "/record/start", "POST", Origin=own, Authorization="Bearer t")[0] == 200
    assert status(server, "/record/stop", "POST", Origin=own, Authorization="Bearer t")[0] == 200
    assert recorder.done == ["start", "stop"]


def test_a_head_that_is_too_long_or_never_ends_is_left(serve, monkeypatch):
    assert status(serve(), "/", X="x" * 70_000)[0] == 431
    monkeypatch.setattr(server_module, "STALL_S", 0.05)
    with socket.create_connection(("127.0.0.1", serve().port), 60) as line:
        line.sendall(b"GET / HT")
        assert line.recv(1) == b""


def test_clients_that_never_finish_a_request_shut_out_neither_a_page_nor_a_new_one(serve, monkeypatch):
    monkeypatch.setattr(server_module, "MAX_CONNECTIONS", 4)
    server = serve("t")
    stream, connection = ask(server, "/stream", Authorization="Bearer t")
    dripping = [socket.create_connection(("127.0.0.1", server.port), 60) for _ in range(20)]
    for line in dripping[-2:]:
        line.sendall(b"GET / HT")
    assert status(server)[0] == 200
    assert dripping[0].recv(1) == b"", "the oldest of them is closed"
    server.board.post("skin", packed({"kind": "skin"}))
    assert next(chunks(stream))[0] == {"kind": "skin"}, "a page with the token stays"
    with socket.create_connection(("127.0.0.1", server.port), 60, ("127.0.0.2", 0)) as other:  # another client
        more = [socket.create_connection(("127.0.0.1", server.port), 60) for _ in range(20)]
        assert status(server)[0] == 200
        other.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
        assert other.recv(12) == b"HTTP/1.1 200"
    for line in [*dripping, *more]:
        line.close()
    connection.close()


def chunks(answer):
    """Yield the messages of a stream as they come."""
    waiting = b""
    while data := answer.read1(65536):
        waiting += data
        whole = unpacked(waiting)
        for head, body in whole:
            waiting = waiting[len(packed(head, body)) :]
            yield head, body


def test_a_page_gets_the_newest_of_each_kind_and_then_what_is_newer(serve):
    server = serve()
    for number in range(5):
        server.board.post("frame", packed({"kind": "frame", "n": number}, b"12"))
    server.board.post("skin", packed({"kind": "skin"}))
    answer, connection = ask(server, "/stream")
    coming = chunks(answer)
    assert next(coming) == ({"kind": "skin"}, b"")
    assert next(coming) == ({"kind": "frame", "n": 4}, b"12")
    server.board.post("status", status_message("silent", "nobody is there"))
    assert next(coming)[0] == {"kind": "status", "of": 0, "state": "silent", "text": "nobody is there"}
    server.board.close()
    assert list(coming) == []
    connection.close()


def test_only_so_many_pages_look_on_at_once(serve, monkeypatch):
    monkeypatch.setattr(board_module, "MAX_PAGES", 1)
    server = serve()
    answer, connection = ask(server, "/stream")
    assert answer.status == 200
    code, text = status(server, "/stream")
    assert code == 503
    assert b"close one" in text
    connection.close()


LEFT = "eitskin view: a page read nothing for 0.2 s and was disconnected; it reconnects by itself\n"


def test_a_page_that_reads_nothing_keeps_nobody_waiting_is_left_and_told_of_in_one_line(serve, monkeypatch, capsys):
    monkeypatch.setattr(server_module, "STALL_S", 0.2)
    server = serve()
    server.board.post("frame", packed({"kind": "frame", "n": 0}, bytes(1 << 20)))
    answer, connection = ask(server, "/stream")
    assert answer.status == 200
    number = 0
    while server.board.pages:  # posting never waits; the page is left once its line is full
        number += 1
        server.board.post("frame", packed({"kind": "frame", "n": number}, bytes(1 << 20)))
        threading.Event().wait(0.01)
    assert capsys.readouterr() == ("", LEFT)
    monkeypatch.setattr(server_module, "STALL_S", 60.0)
    again, _ = ask(server, "/stream")  # it connects again, and nothing of before stands in its way
    assert next(chunks(again))[0] == {"kind": "frame", "n": number}
    again.close()
    connection.close()
    while server.board.pages:  # one that goes is no stall
        server.board.post("frame", packed({"kind": "frame", "n": number}, bytes(1 << 20)))
        threading.Event().wait(0.01)
    assert capsys.readouterr() == ("", "")
