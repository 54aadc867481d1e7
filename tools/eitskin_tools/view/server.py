"""The server of the page: the standard library's, with everything bounded.

A request names a listed path and has no body. At most ``MAX_CONNECTIONS`` are open at a time. A further one replaces
the oldest of the client that has the most without the token, so that no client shuts out another. A connection that
neither sends nor reads for ``STALL_S`` is closed. ``/stream`` is one answer without end, in chunks, each with the
newest message of each kind; a line reports a page that does not read it. ``/part/N`` is one second of a recording.
"""

import contextlib
import errno
import hmac
import ipaddress
import secrets
import socket
import threading
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, Final, Self

from eitskin.errors import SkinError
from eitskin_tools.console.terminal import note
from eitskin_tools.view.board import MAX_PAGES, Board

MAX_CONNECTIONS: Final = 64
"""Connections at a time."""

STALL_S: Final = 5.0
"""How long a page may take to send a request or to read an answer."""

SEND_BYTES: Final = 65536
"""Buffer of the kernel for a page: a few pictures, so that a page that stalled shows no old ones."""

PART: Final = "/part/"
"""Begins the path of a part of a recording; a number follows."""

ACTIONS: Final = ("/record/start", "/record/stop")
"""Actions of a page, by POST without a body."""


class PortUnavailable(SkinError):  # noqa: N818 -- named as the runtime's own are
    """The address cannot be bound; the text says why, and what to do."""


class ViewServer(ThreadingHTTPServer):
    """Serves one board to any number of pages.

    Args:
        host: Address to bind to.
        port: 0 for any that is free.
        board: The messages to pages.
        token: Required from a page for all but its files; empty if it shows nothing else.
        recorder: The :class:`~eitskin_tools.view.viewer.Recorder`; None if pages cannot record.
        film: The :class:`~eitskin_tools.view.film.Film` whose parts pages fetch; None for live skins.
        allowed: Further host names that a request may state, such as a proxy's.

    Raises:
        PortUnavailable: The address cannot be bound.
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = 32
    allow_reuse_address = True

    def __init__(
        self,
        host: str,
        port: int,
        board: Board,
        token: str = "",
        recorder: Any = None,
        film: Any = None,
        allowed: Sequence[str] = (),
    ) -> None:
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self.host, self.board, self.token = host, board, token
        self.recorder, self.film, self.allowed = recorder, film, {name.lower() for name in allowed}
        self.pages = pages()
        self._lock = threading.Lock()
        self._open: dict[Any, str] = {}
        """Open connections, the oldest first, with the client's address; "" once they have shown the token."""
        try:
            super().__init__((host, port), _Request)
        except OSError as error:
            raise PortUnavailable(why_not_bound(host, port, error)) from error
        self.port: int = self.server_address[1]

    @property
    def address(self) -> str:
        """The address to open in a browser."""
        return page_address(self.host, self.port, self.token)

    def server_bind(self) -> None:
        """Bind without a look-up of names, which can take seconds."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = self.host, self.server_address[1]

    def process_request(self, request: Any, client_address: Any) -> None:
        """Accept a connection, and close another one if there are too many."""
        with self._lock:
            room = len(self._open) < MAX_CONNECTIONS or self._close_one()
            if room:
                self._open[request] = client_address[0]
        if room:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def _close_one(self) -> bool:
        """Close the oldest connection of the client that has the most without the token; return whether one has any."""
        clients = Counter(client for client in self._open.values() if client)
        if not clients:
            return False
        ((most, _),) = clients.most_common(1)
        oldest = next(request for request, client in self._open.items() if client == most)
        del self._open[oldest]
        with contextlib.suppress(OSError):  # its client closed it
            oldest.shutdown(socket.SHUT_RDWR)
        return True

    def trust(self, request: Any) -> None:
        """Keep a connection that has shown the token."""
        with self._lock:
            if request in self._open:
                self._open[request] = ""

    def shutdown_request(self, request: Any) -> None:
        """Forget a connection that ends."""
        with self._lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing: a page that closes is no error."""


@contextlib.contextmanager
def report_stalled_page() -> Iterator[None]:
    """Report in one line that a page is disconnected because it does not read."""
    try:
        yield
    except TimeoutError:
        said = f"a page read nothing for {STALL_S:g} s and was disconnected; it reconnects by itself"
        note(f"eitskin view: {said}")
        raise


class _Request(BaseHTTPRequestHandler):
    """One connection and its requests, one after another."""

    server: ViewServer
    protocol_version = "HTTP/1.1"
    server_version = "eitskin"
    sys_version = ""
    wbufsize = 0

    def setup(self) -> None:
        super().setup()
        self.connection.settimeout(STALL_S)
        self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)

    def handle_one_request(self) -> None:
        """Answer a request, unless the connection ends meanwhile."""
        try:
            super().handle_one_request()
        except OSError:
            self.close_connection = True

    def do_GET(self) -> None:
        """Send a file of the page, the stream, or a part of a recording."""
        if not self._trusted():
            return
        if self.path == "/stream":
            self._stream()
        elif self.path.startswith(PART) and self.server.film is not None:
            self._part(self.server.film, self.path.removeprefix(PART))
        elif self.path in self.server.pages:
            kind, body = self.server.pages[self.path]
            self._answer(HTTPStatus.OK, body, kind)
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such page")

    def do_POST(self) -> None:
        """Start or stop a recording."""
        if not self._trusted():
            return
        recorder = self.server.recorder
        if self.path not in ACTIONS or recorder is None:
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such action")
        elif not self.headers.get("Origin", "").endswith(f"://{self.headers.get('Host')}"):
            self._refuse(HTTPStatus.FORBIDDEN, "only the page itself may ask for this")
        elif not self._token_missing():
            why_not = recorder.start() if self.path == "/record/start" else recorder.stop()
            self._answer(HTTPStatus.CONFLICT if why_not else HTTPStatus.OK, why_not.encode(), "text/plain")

    def _trusted(self) -> bool:
        """Return whether to answer the request; refuse it if not."""
        host = self.headers.get("Host", "")
        if not host_allowed(host, self.server.host, self.server.allowed):
            where = self.server.address.partition("#")[0]
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST, f"open {where}, or allow this host with --allow-host")
        elif self.headers.get("Sec-Fetch-Site", "") not in OWN_FETCH_SITES:
            self._refuse(HTTPStatus.FORBIDDEN, "only the page itself may ask for this")
        elif self.headers.get("Content-Length", "0") != "0" or "Transfer-Encoding" in self.headers:
            self.close_connection = True
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "a request must have no body")
        else:
            return True
        return False

    def _part(self, film: Any, number: str) -> None:
        """Send a part of a recording."""
        if not number.isdecimal() or len(number) > 9 or int(number) >= film.parts:
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such part")
        elif self._token_missing():
            return
        else:
            try:
                body = film.part(int(number))
            except (SkinError, OSError, ValueError) as error:  # a file may hold anything
                self._refuse(HTTPStatus.CONFLICT, str(error))
                return
            with report_stalled_page():
                self._answer(HTTPStatus.OK, body, "application/octet-stream")

    def _token_missing(self) -> bool:
        """Return whether the page lacks the token, and refuse the request if so."""
        if token_given(self.headers.get("Authorization", ""), self.server.token):
            self.server.trust(self.connection)
            return False
        self._refuse(HTTPStatus.UNAUTHORIZED, "open the address that 'eitskin view' printed: it contains the token")
        return True

    def _stream(self) -> None:
        """Send the newest messages until the page closes."""
        self.close_connection = True
        if self._token_missing():
            return
        board = self.server.board
        with board.page() as room, report_stalled_page():
            if board.closed:
                return  # the viewer is closing: a page without an answer tries again
            if not room:
                self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_PAGES} pages are open already; close one")
                return
            self._head_of(HTTPStatus.OK, "application/octet-stream", {"Transfer-Encoding": "chunked"})
            seen = 0
            while not board.closed:
                seen, messages = board.newer(seen, 1.0)
                if messages:
                    body = b"".join(messages)
                    self.connection.sendall(b"%x\r\n%b\r\n" % (len(body), body))
            self.connection.sendall(b"0\r\n\r\n")

    def _answer(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self._head_of(status, kind, {"Content-Length": str(len(body))})
        self.connection.sendall(body)

    def _head_of(self, status: HTTPStatus, kind: str, more: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, **more, **HEADERS}.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self.close_connection = True
        self._answer(status, f"{text}\n".encode(), "text/plain; charset=utf-8")

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse in one line of plain text, which repeats nothing of the request."""
        self._refuse(HTTPStatus(code), HTTPStatus(code).phrase.lower())

    def log_message(self, format: str, *args: Any) -> None:
        """Keep no log."""


OWN_FETCH_SITES: Final = ("same-origin", "none", "")
"""Sec-Fetch-Site of our own page, of a typed address, and of a browser that sends none."""


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def host_allowed(host: str, bound: str, allowed: Collection[str] = ()) -> bool:
    """Return whether a Host header names this server; its port is that of any tunnel or proxy in front.

    Args:
        host: The header.
        bound: Address of the server.
        allowed: Further names, in lower case.
    """
    host = host.strip().lower()
    name = host[1:].partition("]")[0] if host.startswith("[") else host.partition(":")[0]
    if name in allowed:
        return True
    if is_loopback(bound):
        return name.endswith(".localhost") or is_loopback(name)
    own = socket.gethostname().lower()
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name in {"localhost", own, f"{own.partition('.')[0]}.local"}
    return True


def token_given(authorization: str, token: str) -> bool:
    """Return whether a request carries the token, if the server has one.

    Args:
        authorization: The header.
        token: Expected, or empty.
    """
    given = authorization.removeprefix("Bearer ").encode("latin-1", "replace")
    return not token or hmac.compare_digest(given, token.encode())


def page_address(host: str, port: int, token: str) -> str:
    """Return the address to open; the token follows the #, so that browsers do not send it in requests.

    Args:
        host: Address of the server.
        port: Port of the server.
        token: Required from the page, or empty.
    """
    name = socket.gethostname() if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/{f'#token={token}' if token else ''}"


def why_not_bound(host: str, port: int, error: OSError) -> str:
    """Return why an address cannot be bound, and what to do."""
    if error.errno == errno.EADDRINUSE:
        return (
            f"port {port} of {host} is in use, perhaps by another 'eitskin view'; choose another with --port, "
            "or any free one with --port 0"
        )
    if error.errno == errno.EACCES:
        return f"port {port} of {host} needs root; choose one above 1023 with --port"
    return f"cannot serve on {host} port {port} ({error.strerror or error}); expected an address of this machine"


TYPES: Final = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
"""Content type by suffix."""

POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content-Security-Policy: only the page's own files, and no inline code."""

HEADERS: Final = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Of every answer."""


def pages() -> dict[str, tuple[str, bytes]]:
    """Return {path: (content type, bytes)} of the page's files; ``/`` is ``index.html``."""
    found = {}
    for entry in resources.files("eitskin_tools.view").joinpath("static").iterdir():
        if kind := TYPES.get(entry.name.rpartition(".")[2]):
            path = "/" if entry.name == "index.html" else f"/{entry.name}"
            found[path] = (kind, entry.read_bytes())
    return found


class PageServer:
    """Serves the messages of its board to pages while it is entered."""

    def __init__(self) -> None:
        self.board = Board()
        self.stack = contextlib.ExitStack()
        """Closed together with the server."""

    def serve(self, host: str, port: int, allowed: Sequence[str], **more: Any) -> None:
        """Bind the address, with a token that nobody can guess: 128 bits.

        Raises:
            PortUnavailable: It cannot be bound.
        """
        self.server = ViewServer(host, port, self.board, secrets.token_urlsafe(16), allowed=allowed, **more)
        self.address = self.server.address
        """The address to open in a browser."""
        self._thread = threading.Thread(target=self.server.serve_forever, args=(0.1,), name="view-server", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.board.closed:
            return
        self.board.close()
        self.stack.close()
        self.server.shutdown()
        self._thread.join()
        self.server.server_close()
