"""``eitskin``: one command, a module a subcommand, imported only when it is named.

``COMMANDS`` is the whole table. A subcommand's module has ``add_arguments(parser)`` and ``run(arguments) -> int``.
Exit status: 0 on success, 2 on bad usage, 1 on failure, with one line on stderr that says what is wrong and what to do.
"""

import argparse
import importlib
import os
import signal
import sys
from collections.abc import Sequence
from typing import Final

from eitskin_proto.errors import SkinError
from eitskin_tools.errors import UsageError

COMMANDS: Final[dict[str, tuple[str, str]]] = {
    "demo": ("live.demo", "a virtual skin, the runtime and a subscriber in three processes, with the map drawn live"),
    "run": ("live.run", "read a skin, publish tactile frames"),
    "subscribe": ("live.subscribe", "print the frames that a runtime publishes"),
    "virtual-skin": ("live.virtual_skin", "a virtual skin behind a pseudo-terminal"),
    "reference": ("live.reference", "capture or show the one pre-deformation reference"),
    "flash": ("live.flash", "show, compare, write, verify or roll back the device's configuration"),
    "surface": ("live.surface", "turn a raw scan of the bent sheet into a 3 x 30 x 45 cloud"),
    "simulate": ("offline.simulate", "solve a scene with the forward model"),
    "dataset": ("offline.dataset", "generate a data set"),
    "train": ("offline.train", "train VD2T"),
    "curves": ("offline.curves", "losses of training runs side by side"),
    "adapt": ("offline.adapt", "teach a trained network to go on without electrodes"),
    "export": ("offline.export", "export a trained network to a bundle"),
    "evaluate": ("offline.evaluate", "score a solver on phantoms"),
    "bench": ("offline.bench", "benchmarks, each with --json"),
    "doctor": ("live.doctor", "list ports, devices, permissions and what to do about each problem"),
}
"""Subcommands in the order of the help: {name: (module below ``eitskin_tools.commands``, what it does)}."""


def _parser(named: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="eitskin", description="Feel through a soft, bending electronic skin.")
    parser.add_argument("--version", action="store_true", help="print the version and the ids, then exit")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, (module, summary) in COMMANDS.items():
        child = subparsers.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        if name == named:
            importlib.import_module(f"eitskin_tools.commands.{module}").add_arguments(child)
    return parser


def _print_version() -> None:
    from importlib.metadata import version

    from eitskin_proto.sensor.ids import GRID_ID, PROTOCOL_ID

    print(f"eitskin {version('eitskin')} protocol_id {PROTOCOL_ID} grid_id {GRID_ID}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    named = next((word for word in words if not word.startswith("-")), None)
    parser = _parser(named if named in COMMANDS else None)
    arguments = parser.parse_args(words)
    if arguments.version:
        _print_version()
        return 0
    if arguments.command is None:
        parser.print_usage(sys.stderr)
        print("eitskin: name a command; 'eitskin --help' lists them", file=sys.stderr)
        return 2
    module = importlib.import_module(f"eitskin_tools.commands.{COMMANDS[arguments.command][0]}")
    try:
        return int(module.run(arguments))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except UsageError as error:
        print(f"eitskin {arguments.command}: {error}", file=sys.stderr)
        return 2
    except (SkinError, ValueError, OSError, ModuleNotFoundError) as error:
        print(f"eitskin {arguments.command}: {_one_line(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, ModuleNotFoundError):
        extra = {"torch": "train", "onnx": "train", "scipy": "sim", "rich": "sim", "matplotlib": "plot"}
        return f"{text}; install it with: pip install 'eitskin[{extra.get(error.name or '', 'sim')}]'"
    return text


if __name__ == "__main__":
    sys.exit(main())
