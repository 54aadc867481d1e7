"""``eitskin``: one command, a module a subcommand, imported only when it is named.

``COMMANDS`` is the whole table. A subcommand's module has ``add_arguments(parser)`` and ``run(arguments) -> int``.
Exit status: 0 on success, 2 on bad usage, 1 on failure, with one line on stderr that says what is wrong and what to do.
A reader that closes standard output early, as ``| head -1`` does, causes no failure.
``run`` has 70 besides (:mod:`eitskin_tools.service.watchdog`).
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
from typing import Final

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

LIVE: Final[dict[str, tuple[str, str]]] = {
    "demo": ("demo", "a virtual skin, the runtime, a scanner and a subscriber, with the map drawn live"),
    "run": ("run", "read a skin, publish tactile frames"),
    "subscribe": ("subscribe", "print the frames that a runtime publishes"),
    "view": ("view", "look at a running skin in the browser"),
    "virtual-skin": ("virtual_skin", "a virtual skin behind a pseudo-terminal"),
    "reference": ("reference", "capture or show the one pre-deformation reference"),
    "flash": ("flash", "show, compare, write, verify or roll back the device's configuration"),
    "surface": ("surface", "order measured points of the bent sheet into a cloud, a point a pixel"),
    "status": ("status", "how the runtime is, or all skins of a robot"),
    "service": ("service", "files for systemd, udev and containers: list, print or write them"),
    "doctor": ("doctor", "list ports, devices, permissions and what to do about each problem"),
}
"""Subcommands around a running skin: {name: (module below ``eitskin_tools.commands``, what it does)}."""

OFFLINE: Final[dict[str, tuple[str, str]]] = {
    "skin": ("skin", "show or check the description of a sheet, skin.toml"),
    "simulate": ("simulate", "solve a scene with the forward model"),
    "dataset": ("dataset", "generate a data set"),
    "train": ("train", "train VD2T"),
    "curves": ("curves", "losses of training runs side by side"),
    "calibrate": ("calibrate", "find out what this device is, from its own readings"),
    "evaluate": ("evaluate", "score a solver on phantoms"),
    "bench": ("bench", "benchmarks, each with --json"),
}
"""Subcommands of simulation, training and evaluation, as in ``LIVE``."""

BUNDLES: Final[dict[str, tuple[str, str]]] = {
    "build": ("build", "data, training, export and card of a bundle, from one file"),
    "export": ("export", "export a trained network to a bundle"),
    "pair": ("pair", "put a smaller network into a bundle"),
    "card": ("card", "what a bundle's network is worth, by contrast and by mismatch"),
    "adapt": ("adapt", "teach a trained network to go on without electrodes"),
    "adapt-skin": ("adapt_skin", "let a bundle go on learning on a calibrated sheet"),
}
"""Subcommands that make bundles and try them, as in ``LIVE``."""

RECORDED: Final[dict[str, tuple[str, str]]] = {
    "record": ("record", "write what a runtime measures into a file that survives power cuts"),
    "replay": ("replay", "publish a recording as if its skin were there"),
    "reinfer": ("reinfer", "compute a recording's maps once more, by the same or by another bundle or solver"),
    "convert": ("convert", "a recording as NPZ, Parquet or rosbag2"),
}
"""Subcommands that write or read recordings, as in ``LIVE``."""

COMMANDS: Final = {**LIVE, **RECORDED, **BUNDLES, **OFFLINE}
"""All subcommands in the order of the help."""

FIRST_STEPS: Final = {
    "eitskin demo": "everything at once, with the map drawn live",
    "eitskin virtual-skin": "a skin on a port, whose path it prints; then, each in a terminal of its own:",
    "eitskin run --port PORT": "read it and publish frames",
    "eitskin subscribe": "see them",
}
"""What to type without hardware, and what it does."""


def _help_text() -> str:
    """Return the commands in four groups, and the first steps, as wide as the terminal."""
    columns = shutil.get_terminal_size().columns - 2  # as argparse has it
    groups = []
    titled = (
        ("around a running skin", LIVE), ("recordings", RECORDED), ("bundles", BUNDLES),
        ("simulation, training, evaluation", OFFLINE),
    )  # fmt: skip
    for title, commands in titled:
        lines = [_row(f"    {name:<14}", summary, columns) for name, (_, summary) in commands.items()]
        groups.append("\n".join([f"{title}:", *lines]))
    steps = [_row(f"  {command:<26}", what, columns) for command, what in FIRST_STEPS.items()]
    more = textwrap.fill("'eitskin COMMAND --help' says what a command takes.", columns)
    return "\n\n".join([*groups, "\n".join(["first steps, without hardware:", *steps]), more])


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
    for name, (module, summary) in COMMANDS.items():
        child = subparsers.add_parser(name, description=summary[0].upper() + summary[1:] + ".")
        if name == named:
            importlib.import_module(f"eitskin_tools.commands.{module}").add_arguments(child)
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
    except BrokenPipeError:  # nobody reads standard output any more
        return status
    except OSError as error:  # of standard output
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
    arguments = parser.parse_args(words)
    if arguments.version:
        _print_version()
        return 0
    if arguments.command is None:
        print("eitskin: name a command; 'eitskin --help' lists them", file=sys.stderr)
        return 2
    module = importlib.import_module(f"eitskin_tools.commands.{COMMANDS[arguments.command][0]}")
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
    except (SkinError, ValueError, OSError, ModuleNotFoundError) as error:
        return _fail(arguments, _one_line(error), 1)
    except MemoryError:
        return _fail(arguments, "there is not enough memory for this; give it less to read or to make", 1)


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
    if isinstance(error, ModuleNotFoundError):
        return f"{text}; install it with: {needs.install([error.name or ''])}"
    return text


if __name__ == "__main__":
    sys.exit(main())
