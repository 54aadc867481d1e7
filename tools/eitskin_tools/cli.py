"""``eitskin``: one command, a module a subcommand, imported only when it is named.

``COMMANDS`` is the whole table. A subcommand's module has ``add_arguments(parser)`` and ``run(arguments) -> int``.
Exit status: 0 on success, 2 on bad usage, 1 on failure, with one line on stderr that says what is wrong and what to do.
A reader that closes standard output early, as ``| head -1`` does, is no failure. ``run`` also has status 70
(:mod:`eitskin_tools.service.watchdog`).
"""

import argparse
import importlib
import json
import os
import shutil
import signal
import sys
import textwrap
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from eitskin_proto.errors import SkinError
from eitskin_proto.files.plain import plain
from eitskin_tools.command_line import files, needs
from eitskin_tools.command_line.parser import Parser
from eitskin_tools.console.terminal import (
    goes_to_journal,
    prefix,
    unread,
    written_out,
)
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.signals import EndRequested, end_signals_as_interrupts


class Command(NamedTuple):
    """A subcommand."""

    group: str
    summary: str
    """What it does, as an order; lower case, no full stop."""
    example: str
    """What to type behind ``eitskin``."""

    def module(self, name: str) -> Any:
        """Return its module, imported now."""
        return importlib.import_module(f"eitskin_tools.commands.{name.replace('-', '_')}")


LIVE, RECORDINGS, SHEET, RESEARCH = "A running skin", "Recordings", "A sheet of your own", "Research and training"

COMMANDS: Final[dict[str, Command]] = {
    "demo": Command(LIVE, "simulate a skin and show what it feels; needs no hardware", "demo --view"),
    "run": Command(LIVE, "read a skin and publish tactile frames", "run --port /dev/ttyACM0 --touches lower"),
    "subscribe": Command(LIVE, "print the frames that a runtime publishes", "subscribe --frames 10"),
    "view": Command(LIVE, "show a running skin or a recording in the browser", "view session.mcap"),
    "virtual-skin": Command(LIVE, "simulate a skin behind a serial port", "virtual-skin --rate 100"),
    "reference": Command(
        LIVE, "capture the reference: the sheet flat and untouched", "reference --port /dev/ttyACM0 --out flat.json"
    ),
    "flash": Command(
        LIVE, "show, compare, write, verify or roll back a device's configuration", "flash show --port /dev/ttyACM0"
    ),
    "surface": Command(
        LIVE, "turn measured points of the bent sheet into a cloud", "surface bent.ply --out cloud.npz --predict --send"
    ),
    "status": Command(LIVE, "report the state of a runtime, or of all skins of a robot", "status"),
    "service": Command(LIVE, "print or write files for systemd, udev and containers", "service --out files"),
    "doctor": Command(LIVE, "check ports, devices and permissions, and say how to repair them", "doctor"),
    "record": Command(RECORDINGS, "write what a runtime measures to a file", "record --out session.mcap --seconds 60"),
    "replay": Command(RECORDINGS, "publish a recording as if its skin were connected", "replay session.mcap"),
    "reinfer": Command(
        RECORDINGS, "compute the maps of a recording again", "reinfer session.mcap --bundle press --json"
    ),
    "plot": Command(
        RECORDINGS, "draw the maps, touches and drift of a recording", "plot session.mcap --out session.png"
    ),
    "convert": Command(
        RECORDINGS,
        "convert a recording to NPZ, Parquet, CSV, rosbag2 or LeRobot",
        "convert session.mcap --out session.npz",
    ),
    "skin": Command(SHEET, "show or check the description of a sheet", "skin show paper"),
    "calibrate": Command(
        SHEET, "estimate the properties of your sheet from its own readings", "calibrate session.npz --out skin.toml"
    ),
    "teach": Command(SHEET, "learn touches from presses at known places", "teach presses.npz --out mine.eitskin"),
    "build": Command(SHEET, "make a bundle for a sheet", "build skin.toml --out mine.eitskin"),
    "adapt-skin": Command(
        SHEET, "train a bundle further on a calibrated sheet", "adapt-skin press --skin skin.toml --out mine.eitskin"
    ),
    "evaluate": Command(SHEET, "measure how accurate a bundle or solver is", "evaluate --phantoms paper_units"),
    "simulate": Command(
        RESEARCH, "compute the voltages of a scene by the forward model", "simulate scene.json --out voltages.npz"
    ),
    "dataset": Command(RESEARCH, "make training data", "dataset --set paper --out data"),
    "train": Command(RESEARCH, "train the network VD2T", "train --recipe units --data data --out run"),
    "export": Command(RESEARCH, "export a trained network as a bundle", "export run --out mine.eitskin"),
    "pair": Command(RESEARCH, "add a smaller network to a bundle", "pair mine.eitskin small.eitskin --out two.eitskin"),
    "card": Command(RESEARCH, "measure how accurate a bundle is by contrast and by mismatch", "card mine.eitskin"),
    "bench": Command(RESEARCH, "run a benchmark", "bench frame --frames 1000 --json"),
}
"""All subcommands in the order of the help; the module of each is called like it, below ``eitskin_tools.commands``."""

NOT_AS_JSON: Final = ("bench", "view")
"""Commands that do not print what they found: each benchmark declares ``--json`` itself."""

FIRST_STEPS: Final = {
    "eitskin demo": "everything at once, shown live",
    "eitskin virtual-skin": "a simulated skin; it prints its port. Then, each in a terminal of its own:",
    "eitskin run --port PORT": "read that skin and publish frames",
    "eitskin subscribe": "print the frames",
}
"""What to type without hardware, and what it does."""


def _help_text() -> str:
    """Return the commands in their groups, and the first steps, as wide as the terminal."""
    columns = shutil.get_terminal_size().columns - 2  # as argparse has it
    groups = []
    for title in (LIVE, RECORDINGS, SHEET, RESEARCH):
        members = {name: command for name, command in COMMANDS.items() if command.group == title}
        lines = [_row(f"    {name:<14}", command.summary, columns) for name, command in members.items()]
        groups.append("\n".join([f"{title}:", *lines]))
    steps = [_row(f"  {command:<26}", what, columns) for command, what in FIRST_STEPS.items()]
    more = textwrap.fill("'eitskin COMMAND --help' describes a command.", columns)
    return "\n\n".join(["\n".join(["First steps, without hardware:", *steps]), *groups, more])


def _row(name: str, text: str, columns: int) -> str:
    """Return a name and what it does, which goes on below itself where a line is full."""
    wide = max(columns, len(name) + 20)
    return textwrap.fill(text, wide, initial_indent=name, subsequent_indent=" " * len(name), break_on_hyphens=False)


def _parser(named: str | None) -> Parser:
    parser = Parser(
        prog="eitskin",
        usage="eitskin [--version] COMMAND ...",
        description="Feel through a soft, bending electronic skin.",
        epilog=_help_text(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        add_help=False,
    )
    parser.add_argument("-h", "--help", action="help", help=argparse.SUPPRESS)
    parser.add_argument("--version", action="store_true", help="print the version and the ids, then exit")
    subparsers = parser.add_subparsers(prog="eitskin", dest="command", metavar="COMMAND", help=argparse.SUPPRESS)
    for name, command in COMMANDS.items():
        child = subparsers.add_parser(
            name,
            description=f"{command.summary[0].upper()}{command.summary[1:]}.",
            epilog=f"example:\n  eitskin {command.example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if name == named:
            command.module(name).add_arguments(child)
            if name not in NOT_AS_JSON:
                child.add_argument("--json", action="store_true", help="print one JSON object at the end")
    return parser


def _print_version() -> None:
    from importlib.metadata import version

    from eitskin_proto.sensor.ids import PROTOCOL_ID
    from eitskin_proto.skin.skin import PAPER

    print(f"eitskin {version('eitskin')} protocol_id {PROTOCOL_ID} grid_id {PAPER.grid_id}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    status = 0
    try:
        with end_signals_as_interrupts(), written_out():
            status = _main(words)
    except BrokenPipeError:  # standard output has lost its reader
        return status
    except (OSError, ImportError, MemoryError) as error:  # of standard output, or before the command began
        print(f"eitskin: {_one_line(error)}", file=sys.stderr)
        return 1
    except EndRequested as request:  # its sender, a shell or systemd, sees that it ended this process
        signal.raise_signal(request.number)
        return 128 + request.number
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    return status


def _main(words: list[str]) -> int:
    named = next((word for word in words if not word.startswith("-")), None)
    parser = _parser(named if named in COMMANDS else None)
    try:
        arguments = parser.parse_args(words)
    except SystemExit as end:  # help was asked for, or the usage is bad
        return int(end.code or 0)
    if arguments.version:
        _print_version()
        return 0
    if arguments.command is None:
        print("eitskin: name a command; 'eitskin --help' lists them", file=sys.stderr)
        return 2
    module = COMMANDS[arguments.command].module(arguments.command)
    try:
        needs.check(arguments)
        files.check_outputs(arguments)
        files.check_inputs(arguments)
        return int(module.run(arguments))
    except BrokenPipeError as error:
        if unread():
            raise
        return _fail(arguments, _one_line(error), 1)
    except UsageError as error:
        return _fail(arguments, str(error), 2)
    except (SkinError, ValueError, OSError, ModuleNotFoundError, MemoryError) as error:
        return _fail(arguments, _one_line(error), 1)


def _fail(arguments: argparse.Namespace, text: str, status: int) -> int:
    """Say what is wrong, in the format of the log where there is one, and return the exit status."""
    before = prefix("error") if goes_to_journal(sys.stderr, os.environ) else ""
    if getattr(arguments, "log_format", "text") == "json":
        print(before + json.dumps({"event": "error", "text": text}), file=sys.stderr)
    else:
        print(f"{before}eitskin {arguments.command}: {plain(text)}", file=sys.stderr)
    return status


def _one_line(error: BaseException) -> str:
    text = (files.explain(error) if isinstance(error, OSError) else None) or str(error)
    text = " ".join(text.split()) or type(error).__name__
    if isinstance(error, MemoryError):
        return "there is not enough memory for this; give it less to read or to make"
    if isinstance(error, ModuleNotFoundError):
        return f"{text}; install it with: {needs.install([error.name or ''])}"
    if isinstance(error, ImportError):
        text = " ".join(str(error.__cause__ or error).split())  # numpy puts a page of advice before the cause
        return f"a module cannot be loaded: {text}; allow more memory, or install it again"
    return text


if __name__ == "__main__":
    sys.exit(main())
