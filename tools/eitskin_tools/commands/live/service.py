"""``eitskin service``: the files with which a system runs skins as a service: listed, printed, or written."""

import argparse
import json
import shutil
import sys
from pathlib import Path

from eitskin_proto.files.reading import FileError
from eitskin_tools.command_line.files import folder
from eitskin_tools.console.say import say
from eitskin_tools.errors import UsageError
from eitskin_tools.service import files

PROGRAM = "/opt/eitskin/bin/eitskin"
"""Where it is installed if that cannot be told."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--print", dest="shown", metavar="NAME", help="print one of the files")
    what.add_argument("--out", type=Path, metavar="DIR", help="write all of them into a folder, to be looked at")
    what.add_argument("--install", action="store_true", help="write them where systemd and udev look; only root may")
    parser.add_argument("--root", type=Path, default=Path("/"), metavar="DIR", help="with --install: of the system (/)")
    parser.add_argument("--user", default="eitskin", metavar="NAME", help="who runs the skins (default eitskin)")
    parser.add_argument("--program", metavar="PATH", help="the eitskin that is started (default: this one)")
    parser.add_argument("--json", action="store_true", help="print one JSON object: what was written or is there")


def run(arguments: argparse.Namespace) -> int:
    """List, print or write, and say what to do next."""
    program = arguments.program or _this_program()
    try:
        files.text_of("eitskin.service", arguments.user, program)
    except ValueError as error:
        raise UsageError(f"--{error}") from error
    if arguments.shown is not None:
        try:
            print(files.text_of(arguments.shown, arguments.user, program), end="")
        except ValueError as error:
            raise UsageError(f"--print: {error}") from error
        return 0
    if arguments.out is None and not arguments.install:
        rows = [{"name": one.name, "home": one.home, "what": one.what} for one in files.FILES]
        if arguments.json:
            print(json.dumps({"files": rows}))
        else:
            for one in files.FILES:
                say(f"{one.name:<24}{one.home or '-':<22}{one.what}")
            say("'eitskin service --print NAME' shows one, 'sudo eitskin service --install --user NAME' writes them")
        return 0
    if arguments.out is not None:
        folder(arguments.out)
    try:
        written = files.write(
            arguments.root if arguments.install else arguments.out, arguments.user, program, homes=arguments.install
        )
    except PermissionError as error:
        if not arguments.install:
            raise
        raise FileError(
            f"no permission for {error.filename}: only root may --install; run 'sudo {_this_program()} service "
            f"--install --user {arguments.user}', or look at the files with --out DIR"
        ) from error
    if arguments.json:
        print(json.dumps({"written": [str(path) for path in written], "user": arguments.user, "program": program}))
        return 0
    for path in written:
        say(f"wrote {path}")
    if arguments.install:
        say(f"next: write /etc/eitskin/robot.toml for user {arguments.user}, of the group dialout; then")
        say("sudo systemctl daemon-reload && sudo udevadm control --reload && sudo systemctl enable --now eitskin")
    return 0


def _this_program() -> str:
    """Return the path of the ``eitskin`` that runs, as far as it can be told."""
    beside = Path(sys.executable).with_name("eitskin")
    found = str(beside) if beside.exists() else shutil.which("eitskin") or PROGRAM
    return found if files.PROGRAM.fullmatch(found) else PROGRAM
