"""Files that a command is given: found by path or by the name of a shipped one, and named when they are missing."""

import argparse
import errno
import os
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_proto.fields import did_you_mean
from eitskin_proto.files.reading import FileError, is_name, kind_of
from eitskin_proto.files.writing import check_target
from eitskin_tools.command_line import kinds
from eitskin_tools.errors import UsageError


class MissingFileError(SkinError):
    """A file that was named is not there; the text says where it was looked for, and what would do."""


@dataclass(frozen=True, slots=True)
class Kind:
    """What a file is expected to hold, and which of its kind come with the package."""

    what: str
    """``a scene as JSON``."""
    package: str = ""
    """Package in which some are shipped; empty for none."""
    suffix: str = ""
    """Of a shipped file: what its name lacks."""
    words: tuple[str, ...] = ()
    """Other values that may be given in place of a file."""

    def names(self) -> tuple[str, ...]:
        """Return the names of the shipped ones, in order."""
        if not self.package:
            return ()
        files = (entry.name for entry in resources.files(self.package).iterdir())
        return tuple(sorted(name.removesuffix(self.suffix) for name in files if name.endswith(self.suffix)))


SCENE: Final = Kind("a scene as JSON", "eitskin_tools.scenes", ".json")
PHANTOMS: Final = Kind("a JSON list of phantoms", "eitskin_tools.phantoms", ".json")
CONFIGURATION: Final = Kind("a configuration as TOML", "eitskin_proto.configurations", ".toml")
POINTS: Final = Kind(
    "measured points of the surface, as .ply, .pcd, .xyz, .csv, .npy, .obj, .stl", "eitskin_tools.scenes", ".ply"
)
RECORDING: Final = Kind("recorded frames as .npy, (n, 104) V, or a .mcap of 'eitskin record'")
MEASURED: Final = Kind("measured samples as .npz, .mat or .csv, see docs/evaluation.md, or a .mcap of 'eitskin record'")
PRESSES: Final = Kind("presses at known places as .npz, see docs/teach.md")
CALIBRATION_RECORDING: Final = Kind("what was recorded of the sheet as .npz, see docs/calibrate.md")
TANK: Final = Kind("frames of a tank as .npz, see docs/evaluation.md")
MISMATCHES: Final = Kind("a JSON list of mismatches", "eitskin_tools.mismatches", ".json", ("lab", "random"))
BUNDLE: Final = Kind("a bundle made by 'eitskin build'", "eitskin.bundles", ".eitskin")
SKIN: Final = Kind("a skin's description as TOML", "eitskin_proto.skins", ".toml")
RECIPE: Final = Kind("a skin's description or a bundle's recipe as TOML", "eitskin_tools.recipes", ".toml")
REFERENCE: Final = Kind("a reference captured by 'eitskin reference'")
KEYS: Final = Kind("a folder made by 'eitskin doctor --make-curve-keys'")
DATA_SET: Final = Kind("a folder made by 'eitskin dataset'")


PICTURES: Final = (".png", ".pdf", ".svg", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".eps", ".ps")
"""How the name of a picture may end; without an end it is a PNG."""

BUNDLE_HELP: Final = "a bundle, shipped or a file"
"""What ``--bundle`` takes, for its help."""


def find(name: str | Path, kind: Kind) -> Path:
    """Return the path of a file that was named: as it stands, or that of the shipped one of this name.

    Args:
        name: A path, or the name of a shipped file without its suffix.
        kind: What it is expected to hold.

    Raises:
        MissingFileError: There is neither.
    """
    path = named(name, kind)
    if path.exists():
        return path
    shipped = (*kind.words, *kind.names())
    expected = f"expected {kind.what}" + (f", or one of the shipped: {', '.join(shipped)}" if shipped else "")
    meant = "" if path.suffix else did_you_mean(path.name, shipped)  # a name with an ending was meant as a file
    raise MissingFileError(f"{_missing(path)}; {expected}{meant}")


def named(name: str | Path, kind: Kind) -> Path:
    """Return the path that a name stands for, as :func:`find`, whether anything is there or not."""
    if is_name(name, kind.names()):
        return Path(str(resources.files(kind.package) / f"{name}{kind.suffix}"))
    return Path(name)


def bundle(name: str) -> Path:
    """Return the path of ``--bundle``: a file, or a shipped bundle."""
    return named(name, BUNDLE)


def check_inputs(arguments: argparse.Namespace) -> None:
    """Refuse a command whose bundle or skin is not there, before it does anything.

    Raises:
        MissingFileError: One is not; the text says which are shipped.
    """
    for name, kind in (("bundle", BUNDLE), ("recorded_bundle", BUNDLE), ("skin", SKIN)):
        given = getattr(arguments, name, None)
        for one in given if isinstance(given, list) else [given]:
            if one is not None:
                find(one, kind)


def parent(path: str | Path) -> Path:
    """Return the path of what is to be written, after a look whether its folder is there and takes files.

    Raises:
        MissingFileError: It is not.
        FileError: It takes none.
    """
    found = Path(path)
    if not found.parent.is_dir():
        raise MissingFileError(f"{_missing(found)}; make it with 'mkdir -p {found.parent}', or name another file")
    if not os.access(found.parent, os.W_OK | os.X_OK):
        raise FileError(f"{path} cannot be written: this user may not write to its folder; name a file in another one")
    return found


def writable(path: str | Path, written: kinds.FileKind | None) -> Path:
    """Return the path of a file that is to be written, before the work that fills it.

    Args:
        path: Of the file.
        written: What is written there, and may be replaced; None where nothing ever is.

    Raises:
        MissingFileError: Its folder is not there.
        FileError: The folder takes no files; or it is there and no regular file: a rename would replace a device, a
            FIFO or a socket; or it is a file of another kind, which would be lost.
        OSError: It is there and cannot be read.
    """
    found = check_target(parent(path))
    if written is not None:
        kinds.check_replaced(found, written)
    return found


def picture(path: str | Path) -> Path:
    """Return the path of a picture that is to be drawn, before the work that it shows; without an end it is a PNG.

    Raises:
        MissingFileError: See :func:`writable`.
        FileError: See there; or its name ends in no format that can be drawn.
    """
    found = writable(path, kinds.PICTURE)
    if found.suffix and found.suffix.lower() not in PICTURES:
        raise FileError(f"{path} ends in {found.suffix!r}, expected one of {', '.join(PICTURES)}")
    return found


def folder(path: str | Path) -> Path:
    """Return the path of a folder that is to be filled, before the work that fills it; it need not be there.

    Raises:
        FileError: It is there and no folder.
    """
    found = Path(path)
    if found.exists() and not found.is_dir():
        raise FileError(f"{path} is {kind_of(found.stat().st_mode)}, expected a folder or a new name; name another")
    return found


def explain(error: OSError) -> str | None:
    """Return one line that names the file of an error, what was found, and what to do; None where no more is known.

    Args:
        error: As the operating system gave it.
    """
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return "too many files are open; allow more with 'ulimit -n', or close some"
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    if error.errno == errno.EFBIG:
        named = "" if error.filename is None else f"{error.filename!r}: "
        return f"{named}the file would be larger than this user may write; allow more with 'ulimit -f'"
    if not isinstance(error.filename, str | bytes | os.PathLike):
        return "no space left where this is written; free some, or write elsewhere" if full else None
    path = Path(os.fsdecode(error.filename))
    if isinstance(error, FileNotFoundError):
        return f"{_missing(path)}; expected it to exist: check the path"
    if isinstance(error, PermissionError):
        return _forbidden(path)
    if isinstance(error, IsADirectoryError):
        return f"{str(path)!r} is a folder; expected a file: name one in it"
    if isinstance(error, NotADirectoryError):
        return f"{str(path)!r}: found a file where a folder was expected; check the path"
    if isinstance(error, FileExistsError):
        return f"{str(path)!r} exists already; name another, or remove it"
    if full:
        return f"no space left for {str(path)!r}; free some, or name another place"
    return f"{str(path)!r} cannot be used: {error.strerror or error}"


def _forbidden(path: Path) -> str:
    if os.path.lexists(path):
        return f"no permission for {str(path)!r}; expected a file of this user: 'ls -ld {path}' shows its owner"
    folder = next(one for one in path.absolute().parents if os.path.lexists(one))
    return f"no permission for {str(path)!r}; expected a folder of this user: 'ls -ld {folder}' shows its owner"


def _missing(path: Path) -> str:
    if not path.parent.exists():
        return f"no folder {str(path.parent)!r} for {str(path)!r}"
    where = "" if path.is_absolute() else f" in {Path.cwd()}"
    return f"no file {str(path)!r}{where}"


OUTPUT_ARGUMENTS: Final = ("out", "plot", "picture", "log", "wire_times")
"""Arguments that name what is written."""

UPDATED_INPUTS: Final[dict[str, tuple[str, ...]]] = {
    "card": ("bundle",), "pair": ("bundle",), "reference": ("against",),
}  # fmt: skip
"""Command -> what it reads and may write anew: nothing of it is lost, or that is what was asked for."""


def check_outputs(arguments: argparse.Namespace) -> None:
    """Refuse a command that would write over what it reads, or twice to one file, before it does anything.

    Raises:
        UsageError: It would.
    """
    given = vars(arguments)
    written = [name for name in OUTPUT_ARGUMENTS if isinstance(given.get(name), str | Path)]
    if given.get("guided"):
        written.append("recording")
    for index, name in enumerate(written):
        target = Path(given[name])
        for other in written[:index]:
            if _same(target, Path(given[other])):
                raise UsageError(f"{_option(name)} and {_option(other)} name the same file, {target}; name two files")
        left_out = (*written, *UPDATED_INPUTS.get(arguments.command, ()))
        for path in (path for other, value in given.items() if other not in left_out for path in _paths(value)):
            if path.is_file() and _same(target, path):
                raise UsageError(
                    f"{_option(name)} {target} is also the input and would be overwritten; name another file"
                )


def _paths(value: Any) -> Iterator[Path]:
    if isinstance(value, str | Path):
        yield Path(value)
    elif isinstance(value, list | tuple):
        yield from (Path(one) for one in value if isinstance(one, str | Path))


def _same(first: Path, second: Path) -> bool:
    """Return whether two names are of one file, there or to be made."""
    try:
        return first.samefile(second)
    except (OSError, ValueError):
        return first.absolute() == second.absolute()


def _option(name: str) -> str:
    return "FILE" if name == "recording" else f"--{name.replace('_', '-')}"
