"""Pages that nobody draws: readers of the stream of ``eitskin view``, each in a thread of this process."""

import http.client
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from urllib.parse import urlsplit


@contextmanager
def readers(address: str, pages: int) -> Iterator[list[int]]:
    """Read the viewer's stream as so many pages would; give how many frames each has taken.

    Args:
        address: Of the page, as ``eitskin view`` says it.
        pages: How many.
    """
    counts, lines, threads = [0] * pages, [], []
    for page in range(pages):
        connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=60)
        connection.request("GET", "/stream")
        lines.append(connection.sock)  # the answer takes it over
        threads.append(threading.Thread(target=_read, args=(connection.getresponse(), counts, page), daemon=True))
        threads[-1].start()
    try:
        yield counts
    finally:
        for line in lines:
            with suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join(30)


def _read(answer: http.client.HTTPResponse, counts: list[int], page: int) -> None:
    from eitskin_tools.view.messages import packed, unpacked

    waiting = b""
    try:
        while data := answer.read1(65536):
            waiting += data
            for head, body in unpacked(waiting):
                waiting = waiting[len(packed(head, body)) :]
                counts[page] += head["kind"] == "frame"
    except (OSError, http.client.HTTPException, ValueError, AttributeError):
        return  # the other end has gone, or this one was closed
