"""A wrapped transport hides nothing of the one that it wraps."""

from eitskin.acquisition.transport import WrappedTransport


class Full:
    """A transport that has all that any has, and notes what is done with it."""

    name, line_bytes_per_s, patience_s, gone = "full", 11_520, 60.0, True

    def __init__(self) -> None:
        self.done: list[tuple[object, ...]] = []

    def read(self, timeout_s: float | None = None) -> bytes:
        self.done.append(("read", timeout_s))
        return b"frame"

    def write(self, data: bytes) -> None:
        self.done.append(("write", data))

    def cancel(self) -> None:
        self.done.append(("cancel",))

    def report(self) -> list[str]:
        return ["latency_timer: 1 ms"]

    def close(self) -> None:
        self.done.append(("close",))

    def reopen(self) -> None:
        self.done.append(("reopen",))


def test_all_that_a_line_has_is_there_through_a_wrapped_one() -> None:
    line = Full()
    wrapped = WrappedTransport(line)
    assert (wrapped.name, wrapped.line_bytes_per_s, wrapped.report()) == ("full", 11_520, ["latency_timer: 1 ms"])
    assert (wrapped.patience_s, wrapped.gone) == (60.0, True)
    assert wrapped.read(0.5) == b"frame"
    wrapped.write(b"request")
    for way in (wrapped.cancel, wrapped.reopen, wrapped.close):
        way()
    assert line.done == [("read", 0.5), ("write", b"request"), ("cancel",), ("reopen",), ("close",)]


def test_what_the_line_does_not_have_is_not_there() -> None:
    class Plain:
        name, line_bytes_per_s = "plain", 0

    wrapped = WrappedTransport(Plain())  # type: ignore[arg-type]
    assert all(getattr(wrapped, name, None) is None for name in ("patience_s", "gone", "reopen", "_private"))
