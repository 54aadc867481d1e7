"""Texts that a terminal would obey are shown instead, and values are quoted within bounds."""

import pytest

from eitskin_proto.errors import ProtocolError
from eitskin_proto.files.plain import plain, quoted, stated
from eitskin_proto.wire.messages import Hello

OBEYED = ["\x1b[2J", "\x9b31m", "\x07", "\r", "\n", "\x7f", "\u202e", "\u2066", "\u200f", "\u2028", "\u0085", "\ud800"]


@pytest.mark.parametrize("code", OBEYED)
def test_what_a_terminal_would_obey_is_shown(code: str) -> None:
    shown = plain(f"skin {code} one")
    assert shown.isprintable()
    assert shown.startswith("skin \\")
    assert shown.endswith(" one")


@pytest.mark.parametrize("value", ["\x1b[2J", "x" * 10**6, [1] * 10**6, {"a": [[]]}, b"\x1b" * 999, None, 1.5])
def test_a_quoted_value_is_short_and_cannot_be_obeyed(value: object) -> None:
    for text in (quoted(value), stated(value)):
        assert text.isprintable()
        assert len(text) < 100


def test_a_device_with_escape_codes_in_its_name_is_refused_in_a_line_that_shows_them() -> None:
    hello = Hello((1, 0, 0), 1, "MARK-ONE", 7, 1, "paper", 200_000, 104, 3, 1e-7)
    payload = hello.pack().replace(b"MARK-ONE", b"\x1b[2Jskin")
    with pytest.raises(ProtocolError, match="printable ASCII") as caught:
        Hello.unpack(payload)
    assert str(caught.value).isprintable()
