"""Files that are long, deep, endless or no files."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from eitskin_proto.files.reading import FileError, parse_json, parse_toml, read_bytes, read_json, read_text

DEEP = 100_000


def test_a_regular_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(FileError, match="longer than 4 bytes"):
        read_bytes(path, 4)


def test_a_sparse_terabyte_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(FileError, match="longer"):
        read_bytes(path, 1 << 20)


@pytest.mark.parametrize("kind", ["folder", "FIFO", "device"])
def test_what_is_no_regular_file_is_named_and_nobody_waits(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a"
    if kind == "folder":
        path.mkdir()
    elif kind == "FIFO":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(FileError, match=f"is a {kind}, expected a regular file"):
        read_bytes(path, 100)


@pytest.mark.process
@pytest.mark.parametrize(("most", "out"), [(100, "5 bytes"), (3, "longer than 3 bytes")])
def test_a_stream_that_was_handed_over_is_read_within_the_bound(most: int, out: str) -> None:
    code = (
        "import sys; from eitskin_proto.files.reading import *\n"
        "try: print(len(read_bytes('/dev/stdin', int(sys.argv[1]))), 'bytes')\n"
        "except FileError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(most)], input=b"12345", capture_output=True, check=True)
    assert out in done.stdout.decode()


@pytest.mark.parametrize("text", ["[" * DEEP, "[" * 40 + "]" * 40, '{"a":' * 40 + "1" + "}" * 40, '{"a":' * DEEP])
def test_deep_json_is_refused_whatever_the_parser_bears(text: str) -> None:
    with pytest.raises(FileError, match="not nested at most 32"):
        parse_json(text)


@pytest.mark.parametrize("text", ["", "{", b"\xff", "1" * 5000, '{"a": 1} 2'])
def test_no_json_is_said_so(text: str | bytes) -> None:
    with pytest.raises(FileError, match="is not JSON"):
        parse_json(text)


@pytest.mark.parametrize("text", ["a = " + "[" * 30_000, "a = [", "x" * 70_000, "a = " + "[" * 40 + "]" * 40])
def test_toml_that_is_long_deep_or_none_is_refused(text: str) -> None:
    with pytest.raises(FileError):
        parse_toml(text)


def test_a_file_is_named_once(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(b"\xff")
    with pytest.raises(FileError, match="not UTF-8"):
        read_text(path)
    path.write_text("{")
    with pytest.raises(FileError, match="is not JSON") as caught:
        read_json(path)
    assert str(caught.value).count(str(path)) == 1
