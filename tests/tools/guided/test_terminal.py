"""Lines that a person types, and the end of them."""

import os

import pytest

from eitskin_tools.guided import Terminal


@pytest.fixture
def typing(monkeypatch):
    """Yield where to type."""
    reading, writing = os.pipe()
    with open(reading, encoding="utf-8") as stream:
        monkeypatch.setattr("sys.stdin", stream)
        yield writing


def test_lines_come_one_by_one_and_none_is_waited_for(typing):
    terminal = Terminal()
    assert terminal.answer() is None
    os.write(typing, b"s\n bent.npz \nq")
    assert (terminal.answer(), terminal.answer(), terminal.answer()) == ("s", "bent.npz", None)
    assert not terminal.left
    os.close(typing)


def test_at_the_end_of_the_input_the_last_line_counts_and_nothing_more_will_come(typing):
    terminal = Terminal()
    os.write(typing, b"q")
    os.close(typing)
    assert terminal.answer() == "q"
    assert terminal.left
    assert terminal.answer() is None
