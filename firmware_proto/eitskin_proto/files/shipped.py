"""TOML files of which some come with the package: whoever asks for those gives a name, for others a path."""

from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import TypeVar

from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import LARGEST_TOML, read_text

Content = TypeVar("Content")


def text_named(name: str, names: Sequence[str], folder: str, what: str) -> str:
    """Return the text of a file that comes with the package.

    Args:
        name: Of the file, without its ending.
        names: All that there are.
        folder: Of the package.
        what: Such a file describes, for people.

    Raises:
        ValueError: There is none of this name.
    """
    if name not in names:
        raise ValueError(f"{what} {quoted(name)} does not come with the package; {', '.join(names)} do")
    return resources.files("eitskin_proto").joinpath(folder, f"{name}.toml").read_text(encoding="utf-8")


def is_name(path: str | Path, names: Sequence[str]) -> bool:
    """Return whether a path is the name of a file that comes with the package: no file of one's own lies there.

    Args:
        path: As it was given.
        names: Of those that come.
    """
    own = Path(path)
    return str(path) in names and (own.is_dir() or not own.exists())


def parse_file(path: str | Path, parse: Callable[[str], Content]) -> Content:
    """Return what a file says.

    Raises:
        ValueError: The file's content is wrong; the text names the file, and what ``parse`` says.
        OSError: There is no such file.
    """
    text = read_text(path, LARGEST_TOML)
    try:
        return parse(text)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
