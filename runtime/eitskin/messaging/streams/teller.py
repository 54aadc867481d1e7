"""Who tells what was measured: what the frame loop needs of it."""

from typing import Final, Protocol

from eitskin.messaging.streams.desk import StreamDesk


class Teller(Protocol):
    """Makes the bodies of streams, and hands them in at a desk. It is only called while the desk is asked."""

    def begin(self, desk: StreamDesk) -> None:
        """Tell this desk from now on."""

    def frame(self, payload: bytes, number: int | None) -> None:
        """Tell of the frame in hand, which is computed, and published with this number, if with any."""

    def withheld(self, payload: bytes, read_ns: int) -> None:
        """Tell of a frame that was withheld just now."""


class Silence:
    """Tells nothing."""

    def begin(self, desk: StreamDesk) -> None:
        """Tell nothing."""

    def frame(self, payload: bytes, number: int | None) -> None:
        """Tell nothing."""

    def withheld(self, payload: bytes, read_ns: int) -> None:
        """Tell nothing."""


def _nowhere(message: bytes) -> None:
    """Take a message that nobody wants."""


_NOBODY: Final = StreamDesk(_nowhere), Silence()


def begin(teller: Teller | None, taker: object, run: str) -> tuple[StreamDesk, Teller]:
    """Return a taker's desk and who tells it; a desk that is never asked where there is none of them.

    Args:
        teller: Of what was measured.
        taker: Of frames; it may have ``streams``.
        run: Differs after each start of the runtime.
    """
    desk = getattr(taker, "streams", None)
    if teller is None or not isinstance(desk, StreamDesk):
        return _NOBODY
    desk.run = run
    teller.begin(desk)
    return desk, teller
