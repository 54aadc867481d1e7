"""A line to a board fails as soon as the board has stopped, and waits for one that is only slow."""

import pytest
from tests.emulator.patience import UntilStopped, patient

from eitskin.errors import PortLost
from eitskin_proto.wire import framing, messages


class Slow:
    """A line on which something comes at the n-th look."""

    name, line_bytes_per_s = "a slow line", 0

    def __init__(self, looks: int) -> None:
        self.looks, self.written = looks, b""

    def read(self, timeout_s: float | None = None) -> bytes:
        self.looks -= 1
        return b"" if self.looks > 0 else b"\x01"

    def write(self, data: bytes) -> None:
        self.written += data


def test_a_read_looks_again_until_something_comes_or_the_board_stops() -> None:
    assert UntilStopped(Slow(7), lambda: False).read() == b"\x01"
    looks = iter([False, False, True])
    with pytest.raises(PortLost, match="a board that has stopped"):
        UntilStopped(Slow(100), lambda: next(looks)).read(60.0)


def test_a_timeout_still_ends_a_read() -> None:
    assert UntilStopped(Slow(10**9), lambda: False).read(0.05) == b""


def test_what_only_some_lines_have_is_there_through_it() -> None:
    line = Slow(1)
    assert not hasattr(UntilStopped(line, lambda: False), "gone")
    line.gone = True
    assert UntilStopped(line, lambda: False).gone


class Starved(Slow):
    """A device that hears the first nine requests too late to answer in time."""

    def __init__(self) -> None:
        super().__init__(0)
        self.deframer = framing.Deframer()
        self.heard: list[messages.Message] = []

    def write(self, data: bytes) -> None:
        self.heard += [messages.unpack(payload) for payload in self.deframer.feed(data)]

    def read(self, timeout_s: float | None = None) -> bytes:
        request = self.heard[-1]
        assert isinstance(request, messages.Stop)
        if len(self.heard) < 10:
            return b""
        return framing.encode(messages.Ack(request=messages.Stop.LAYOUT.type, tag=request.tag).pack())


def test_a_starved_board_is_asked_again_and_is_not_gone() -> None:
    line = Starved()
    assert patient(line).command(messages.Stop).detail == 0
    assert len(line.heard) == 10
