"""Every command that reads a recording, at every file that it cannot use: one line, status 1, nothing printed."""

import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from eitskin import SkinState, WireFrame
from eitskin_tools import cli
from eitskin_tools.processes.signals import endings

from ..conftest import TINY, recorded, rewritten

OTHER_ID = "0123456789abcdef"
SECOND = TINY.with_name("second.eitskin")

READERS: dict[str, list[str]] = {
    "replay": ["replay", "FILE", "--bundle", str(TINY), "--quiet", "--publish", "ipc://f", "--control", "ipc://c"],
    "reinfer": ["reinfer", "FILE", "--bundle", str(TINY), "--quiet"],
    "convert": ["convert", "FILE", "--out", "out.npz"],
    "view": ["view", "FILE", "--bundle", str(TINY), "--no-open", "--port", "0"],
    "evaluate": ["evaluate", "--measured", "FILE", "--solver", "tikhonov", "--bundle", str(TINY)],
    "doctor electrodes": ["doctor", "--electrodes", "--recorded", "FILE"],
}  # fmt: skip
"""Commands that read a recording; FILE stands for its path."""

Make = Callable[[Path, list[Any]], None]


def changed(items: list[Any], **fields: Any) -> list[Any]:
    """Return a stream that says something else of the skin."""
    return [replace(one, **fields) if isinstance(one, SkinState) else one for one in items]


def holding(content: bytes) -> Make:
    return lambda path, _: void(path.write_bytes(content))


def void(_: object) -> None:
    """Take a value for nothing."""


def missing(path: Path, items: list[Any]) -> None:
    """There is no file."""


def of_another_program(path: Path, items: list[Any]) -> None:
    with path.open("wb") as stream:
        made = Writer(stream)
        made.start()
        made.add_message(made.register_channel("/x", "json", 0), 1, b"{}", 1)
        made.finish()


def with_head(**head: str) -> Make:
    def make(path: Path, items: list[Any]) -> None:
        recorded(path, items)
        rewritten(path, lambda _, data, ns: (data, ns), head=head).rename(path)

    return make


def cut_before_the_first_frame(path: Path, items: list[Any]) -> None:
    recorded(path, items)
    path.write_bytes(path.read_bytes()[:2500])


FILES: dict[str, tuple[Make, str]] = {
    "missing": (missing, "no file"),
    "device": (lambda path, _: path.symlink_to("/dev/zero"), "is a device"),
    "empty": (holding(b""), "is empty"),
    "cut in the head": (holding(b"\x89MCAP0\r\n"), "ends within its header"),
    "cut before the first frame": (cut_before_the_first_frame, "holds no frame from the device; it was cut off"),
    "without a frame": (
        lambda path, items: void(recorded(path, [one for one in items if not isinstance(one, WireFrame)])),
        "holds no frame from the device",
    ),
    "another program's": (of_another_program, "this is another program's MCAP file"),
    "newer": (with_head(version="2"), "version 2, this release reads up to 1"),
    "another protocol": (with_head(protocol_id=OTHER_ID), f"protocol_id: found {OTHER_ID}"),
    "HELLO": (with_head(hello="80ff"), "the device's HELLO cannot be read"),
    "without a reference": (
        lambda path, items: void(recorded(path, changed(items, reference=None))), "has no reference"
    ),
}  # fmt: skip
"""How each file is made, and what is said of it."""

SOME_FILES = ("missing", "empty", "another protocol", "without a reference")
"""For the commands that read a file as 'reinfer' does; 'view' reads it in another way."""


@pytest.fixture
def handlers() -> Iterator[None]:
    """Signals are handled afterwards as before."""
    before = {number: signal.getsignal(number) for number in endings()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, handlers: None) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], words: list[str], file: str = "a.mcap") -> str:
    """Run a command that cannot do it, and return the one line that it said."""
    status = cli.main([file if word == "FILE" else word for word in words])
    out, err = capsys.readouterr()
    assert (status, out) == (1, "")
    assert err.count("\n") == 1, err
    assert err.startswith(f"eitskin {words[0]}: ")
    return str(err)


@pytest.mark.parametrize(
    ("reader", "kind"),
    [(reader, kind) for reader in READERS for kind in (FILES if reader in ("reinfer", "view") else SOME_FILES)],
)
def test_a_file_that_cannot_be_used_is_one_line(
    here: Path, items: list[Any], capsys: pytest.CaptureFixture[str], reader: str, kind: str
) -> None:
    make, says = FILES[kind]
    make(here / "a.mcap", items)
    before = set(here.iterdir())
    said = refused(capsys, READERS[reader])
    assert says in said
    assert "a.mcap" in said
    assert set(here.iterdir()) == before, "it left a file"


@pytest.mark.parametrize("reader", [name for name, words in READERS.items() if "--bundle" in words])
def test_a_bundle_of_another_skin_is_one_line(
    here: Path, items: list[Any], capsys: pytest.CaptureFixture[str], reader: str
) -> None:
    recorded(here / "a.mcap", items)
    said = refused(capsys, [str(SECOND) if word == str(TINY) else word for word in READERS[reader]])
    assert "grid_id" in said or "skin" in said


@pytest.mark.parametrize("reader", ["replay", "reinfer", "view"])
def test_a_bundle_that_is_not_there_is_asked_for_in_one_line(
    here: Path, items: list[Any], capsys: pytest.CaptureFixture[str], reader: str
) -> None:
    recorded(here / "a.mcap", items)
    words = [word for word in READERS[reader] if word not in ("--bundle", str(TINY))]
    assert "name it with --bundle" in refused(capsys, words)


@pytest.mark.parametrize("reader", [name for name in READERS if name != "convert"])
def test_a_recording_of_another_skin_is_one_line(
    here: Path, items: list[Any], capsys: pytest.CaptureFixture[str], reader: str
) -> None:
    """Voltages alone are the same on every sheet."""
    recorded(here / "a.mcap", changed(items, grid_id=OTHER_ID))
    assert f"grid_id: found {OTHER_ID}" in refused(capsys, READERS[reader])


@pytest.mark.parametrize("reader", ["reinfer", "convert", "evaluate", "doctor electrodes"])
def test_a_file_that_was_cut_is_read_to_its_end_and_one_line_says_so(
    here: Path, items: list[Any], capsys: pytest.CaptureFixture[str], reader: str
) -> None:
    """Of 'replay' and 'view' other tests say so: they go on."""
    recorded(here / "a.mcap", items)
    (here / "a.mcap").write_bytes((here / "a.mcap").read_bytes()[:-200])
    assert cli.main(["a.mcap" if word == "FILE" else word for word in READERS[reader]]) == 0
    out, err = capsys.readouterr()
    assert out
    assert err == f"eitskin {READERS[reader][0]}: a.mcap; it was cut off and ends early\n"
