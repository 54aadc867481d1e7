"""Reads files within bounds on their length, kind and depth of nesting.

A path may name anything: a device that never ends, a FIFO without a writer, a file that grows while it is read. Only
regular files are read, up to a bound; a stream that the caller hands over, ``/dev/stdin`` or ``/dev/fd/N`` as a shell's
``<(...)`` makes them, is read up to the same bound.
"""

import json
import os
import stat
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, BinaryIO, Final, Generic, TypeVar

from eitskin_proto.errors import SkinError
from eitskin_proto.files.plain import quoted

HANDED_OVER: Final = ("/dev/stdin", "/dev/fd/", "/proc/self/fd/")
"""How paths of open streams begin."""

DEEPEST: Final = 32
"""Levels of nested lists and objects; the deepest file of ours has 7."""

TOO_DEEP: Final = f"is not nested at most {DEEPEST} levels deep, as every such file is"

LARGEST_TEXT: Final = 16 << 20
"""Bytes of a JSON file."""

LARGEST_TOML: Final = 64 << 10
"""Bytes of a TOML file: a configuration has 500, and the parser takes a time that grows with the square."""

KINDS: Final[tuple[tuple[Callable[[int], bool], str], ...]] = (
    (stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a FIFO"), (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"),
)  # fmt: skip


class FileError(SkinError, ValueError):
    """A file that is not read: no regular one, too long, nested too deeply, or no text of its kind."""


def _known(*names: str) -> int:
    """Return those flags of ``os.open`` that this system has; Windows has few, and one that others do not need."""
    return sum(getattr(os, name, 0) for name in names)


READ: Final = os.O_RDONLY | _known("O_CLOEXEC", "O_NOCTTY", "O_BINARY")
NOT_WAIT: Final = _known("O_NONBLOCK")


def kind_of(mode: int) -> str:
    """Return a file's kind, by ``st_mode``."""
    return next((name for fits, name in KINDS if fits(mode)), "a file")


@contextmanager
def opened(path: str | Path, largest: int) -> Iterator[BinaryIO]:
    """Open a file to be read; the reader of a stream compares its bytes with ``largest``.

    Args:
        path: A regular file, or a stream that was handed over.
        largest: Most bytes that it may have.

    Raises:
        FileError: It is neither, or longer.
        OSError: It cannot be opened.
    """
    given = os.path.abspath(path)
    handed_over = given.startswith(HANDED_OVER)
    # a FIFO would wait for its writer, a terminal could become the process's own
    file = os.open(path, READ | (0 if handed_over else NOT_WAIT))
    try:
        found = os.fstat(file)
        if not stat.S_ISREG(found.st_mode) and (not handed_over or stat.S_ISDIR(found.st_mode)):
            raise FileError(f"{path} is {kind_of(found.st_mode)}, expected a regular file; name one")
        if found.st_size > largest and stat.S_ISREG(found.st_mode):
            raise FileError(_too_long(path, largest))
        stream = open(file, "rb")  # noqa: SIM115 -- closed below, also if this fails
    except BaseException:
        os.close(file)
        raise
    with stream:
        yield stream


def read_bytes(path: str | Path, largest: int) -> bytes:
    """Return a file's content.

    Args:
        path: A regular file, or a stream that was handed over.
        largest: Most bytes that it may have.

    Raises:
        FileError: It is neither, or longer.
        OSError: It cannot be read.
    """
    with opened(path, largest) as stream:
        content = stream.read(largest + 1)
    if len(content) > largest:
        raise FileError(_too_long(path, largest))
    return content


def read_text(path: str | Path, largest: int = LARGEST_TEXT) -> str:
    """Return a UTF-8 file's text.

    Raises:
        FileError: It is no such file, or longer.
        OSError: It cannot be read.
    """
    try:
        return read_bytes(path, largest).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(f"{path} is not UTF-8 text: {error}; expected a text file") from error


def read_json(path: str | Path, largest: int = LARGEST_TEXT) -> Any:
    """Return the content of a JSON file.

    Raises:
        FileError: It is none, too long, or nested too deeply.
        OSError: It cannot be read.
    """
    try:
        return parse_json(read_text(path, largest))
    except FileError as error:
        raise FileError(str(error) if str(path) in str(error) else f"{path} {error}") from error


def parse_json(text: str | bytes, *, strict: bool = False) -> Any:
    """Return the content of a JSON text; the error's message continues after the text's name.

    Args:
        text: The text, whose length the caller bounds.
        strict: Refuse a key that an object has twice, NaN and Infinity too.

    Raises:
        FileError: It is no JSON, or nested too deeply.
    """
    try:
        found = json.loads(text, object_pairs_hook=_once, parse_constant=_refuse) if strict else json.loads(text)
    except FileError:
        raise
    except RecursionError as error:
        raise FileError(TOO_DEEP) from error
    except ValueError as error:
        raise FileError(f"is not JSON: {error}") from error
    _check_depth(found)
    return found


def _once(items: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(items)
    if len(found) < len(items):
        names = [key for key, _ in items]
        twice = next(key for key in names if names.count(key) > 1)
        raise FileError(f"has the key {quoted(twice)} twice in one object, expected once")
    return found


def _refuse(name: str) -> Any:
    raise FileError(f"holds {name}, expected finite numbers")


def parse_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML text.

    Raises:
        FileError: It is no TOML, too long, or nested too deeply.
    """
    if len(text) > LARGEST_TOML:
        raise FileError(f"it has {len(text)} characters, expected at most {LARGEST_TOML}")
    try:
        found = tomllib.loads(text)
    except RecursionError as error:
        raise FileError(TOO_DEEP) from error
    except (ValueError, OverflowError, ArithmeticError) as error:
        raise FileError(f"not a TOML file: {error}") from error
    _check_depth(found)
    return found


def _check_depth(value: object) -> None:
    """Refuse content that is nested too deeply, without recursion."""
    level = [value]
    for _ in range(DEEPEST):
        level = [
            item
            for value in level
            for item in (value.values() if isinstance(value, dict) else value if isinstance(value, list) else ())
            if isinstance(item, dict | list)
        ]
        if not level:
            return
    raise FileError(TOO_DEEP)


def _too_long(path: str | Path, largest: int) -> str:
    return f"{path} is longer than {largest} bytes, the most that such a file may have; name another"


Content = TypeVar("Content")


def is_name(path: str | Path, names: Sequence[str]) -> bool:
    """Return whether a path is the name of a file that comes with the package, and no file in this folder has it.

    Args:
        path: As it was given.
        names: Of those that come.
    """
    own = Path(path)
    return str(path) in names and (own.is_dir() or not own.exists())


@dataclass(frozen=True, slots=True)
class ShippedFiles(Generic[Content]):
    """TOML files of one kind, of which some come with the package.

    Args:
        names: Of those, without their ending.
        folder: Of the package.
        what: Such a file describes, for people.
        parse: Returns the content of a text; raises ValueError.
    """

    names: Sequence[str]
    folder: str
    what: str
    parse: Callable[[str], Content]

    def named(self, name: str) -> Content:
        """Return the content of one that comes with the package.

        Raises:
            ValueError: There is none of this name.
        """
        if name not in self.names:
            raise ValueError(f"{self.what} {quoted(name)} does not come with the package; {', '.join(self.names)} do")
        file = resources.files("eitskin_proto").joinpath(self.folder, f"{name}.toml")
        return self.parse(file.read_text(encoding="utf-8"))

    def load(self, path: str | Path) -> Content:
        """Return the content of a file, or of one that comes with the package if only its name is given.

        Raises:
            ValueError: The file's content is wrong; the text names file and key.
            OSError: There is no such file.
        """
        if is_name(path, self.names):
            return self.named(str(path))
        text = read_text(path, LARGEST_TOML)
        try:
            return self.parse(text)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
