"""``eitskin service``: the files with which a system runs skins as a service: listed, printed, or written."""

import argparse
import re
import shutil
import sys
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from eitskin_proto.files.reading import FileError
from eitskin_tools.command_line.files import folder
from eitskin_tools.console.terminal import answer
from eitskin_tools.errors import UsageError

FOLDER: Final = "shipped"

COMMON_FILE: Final = "common.conf"

USER_NAME: Final = re.compile(r"[a-z_][a-z0-9_-]{0,30}")
PROGRAM_PATH: Final = re.compile(r"(/[A-Za-z0-9._+@-]+)+")


@dataclass(frozen=True, slots=True)
class ServiceFile:
    """One of the files.

    Attributes:
        name: Its name.
        home: The folder of the system in which it belongs; empty for none.
        what: For people.
    """

    name: str
    home: str
    what: str


FILES: Final = (
    ServiceFile("eitskin.service", "/etc/systemd/system", "all skins of /etc/eitskin/robot.toml"),
    ServiceFile("eitskin@.service", "/etc/systemd/system", "eitskin@NAME: the skins of /etc/eitskin/NAME.toml"),
    ServiceFile("61-eitskin-start.rules", "/etc/udev/rules.d", "starts eitskin.service when a skin is plugged in"),
    ServiceFile("Containerfile", "", "a container that runs /etc/eitskin/robot.toml"),
)


def text_of(name: str, user: str, program: str) -> str:
    """Return the text of a file.

    Args:
        name: One of ``FILES``.
        user: The user that runs the skins.
        program: Path of the ``eitskin`` that the units start.
    """
    text = _read(name)
    if name.endswith(".service"):
        text = text.replace("{common}", _read(COMMON_FILE)).replace("{user}", user).replace("{eitskin}", program)
    return text


def _read(name: str) -> str:
    return resources.files("eitskin_tools.service").joinpath(FOLDER, name).read_text(encoding="utf-8")


def write(root: Path, user: str, program: str, *, homes: bool) -> list[Path]:
    """Write the files and return where they are.

    Args:
        root: Folder to write into; ``/`` for the system itself.
        user: See :func:`text_of`.
        program: See :func:`text_of`.
        homes: Into the folders in which the system wants them, those without one left out; else side by side.

    Raises:
        OSError: They cannot be written.
    """
    from eitskin_proto.files.writing import write_bytes

    texts = {one: text_of(one.name, user, program) for one in FILES if one.home or not homes}
    written = []
    for one, text in texts.items():
        folder = root / one.home.lstrip("/") if homes else root
        folder.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / one.name, text.encode(), 0o644)
        written.append(folder / one.name)
    return written


PROGRAM = "/opt/eitskin/bin/eitskin"
"""Where it is installed if that cannot be told."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--print", dest="shown", choices=[one.name for one in FILES], metavar="NAME", help="print one of the files"
    )
    what.add_argument("--out", type=Path, metavar="DIR", help="write all files to a folder")
    what.add_argument("--install", action="store_true", help="write them where systemd and udev read them; needs root")
    parser.add_argument("--user", default="eitskin", metavar="NAME", help="user that runs the skins (default eitskin)")


def run(arguments: argparse.Namespace) -> int:
    """List, print or write, and say what to do next."""
    program = _this_program()
    if USER_NAME.fullmatch(arguments.user) is None:
        expected = "expected a name such as robot: small letters, digits, - and _"
        raise UsageError(f"--user is {arguments.user!r}, {expected}")
    if arguments.shown is not None:
        print(text_of(arguments.shown, arguments.user, program), end="")
        return 0
    if arguments.out is None and not arguments.install:
        rows = [{"name": one.name, "home": one.home, "what": one.what} for one in FILES]
        more = "'eitskin service --print NAME' shows one, 'sudo eitskin service --install --user NAME' writes them"
        lines = [f"{one.name:<24}{one.home or '-':<22}{one.what}" for one in FILES]
        return answer(arguments, {"files": rows}, *lines, more)
    if arguments.out is not None:
        folder(arguments.out)
    root = Path("/") if arguments.install else arguments.out
    try:
        written = write(root, arguments.user, program, homes=arguments.install)
    except PermissionError as error:
        if not arguments.install:
            raise
        raise FileError(
            f"no permission for {error.filename}: only root may --install; run 'sudo {_this_program()} service "
            f"--install --user {arguments.user}', or write the files elsewhere with --out DIR"
        ) from error
    lines = [f"wrote {path}" for path in written]
    if arguments.install:
        lines += [
            f"next: write /etc/eitskin/robot.toml for user {arguments.user}, of the group dialout; then",
            "sudo systemctl daemon-reload && sudo udevadm control --reload && sudo systemctl enable --now eitskin",
        ]
    found = {"written": [str(path) for path in written], "user": arguments.user, "program": program}
    return answer(arguments, found, *lines)


def _this_program() -> str:
    """Return the path of the ``eitskin`` that runs, as far as it can be told."""
    beside = Path(sys.executable).with_name("eitskin")
    found = str(beside) if beside.exists() else shutil.which("eitskin") or PROGRAM
    return found if PROGRAM_PATH.fullmatch(found) else PROGRAM
