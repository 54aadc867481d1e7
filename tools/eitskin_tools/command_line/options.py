"""Options that several commands have, and how their values are checked before anything is opened."""

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_tools.command_line import files
from eitskin_tools.command_line.parser import expected_one_of, positive, whole, within
from eitskin_tools.errors import UsageError

if TYPE_CHECKING:
    from eitskin.messaging.curve_keys import ClientKeys
    from eitskin_proto.skin.skin import Skin

TOUCH_KINDS: Final[tuple[TouchKind, ...]] = ("lower", "raise")
"""What ``--touches`` takes."""


def flag(name: str) -> str:
    """Return an argument's name as it is typed."""
    return f"--{name.replace('_', '-')}"


def check_solver(arguments: argparse.Namespace) -> None:
    """Refuse a ``--solver`` that no stream has."""
    from eitskin.model.manifest import SOLVERS

    if arguments.solver is not None and arguments.solver not in SOLVERS:
        raise UsageError(expected_one_of("--solver", arguments.solver, SOLVERS))


SEED: Final = whole(0, 1_000_000_000)
"""``--seed``: up to the largest from which every generator can draw."""

SNR_DB: Final = within(0.0, 200.0)
"""``--snr-db``: from as loud as the signal to far below the last bit of any converter."""

SPAN_S: Final = within(0.0, 1e9)
"""``--from`` and ``--to``: nothing was recorded for longer than thirty years."""


def add_bundle(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare ``--bundle``.

    Args:
        parser: Of the command.
        what: What the bundle is for, and which one is the default.
    """
    parser.add_argument("--bundle", type=files.bundle, metavar="FILE", help=f"{files.BUNDLE_HELP}, {what}")


def add_reconnect(parser: argparse.ArgumentParser) -> None:
    """Declare ``--reconnect``."""
    parser.add_argument(
        "--reconnect",
        type=positive(1e9),
        metavar="S",
        help="wait up to S s for a port that is gone or busy (default: end)",
    )


def add_skin(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare ``--skin``.

    Args:
        parser: Of the command.
        what: What of the skin the command uses.
    """
    names = ", ".join(files.SKIN.names())
    parser.add_argument(
        "--skin", metavar="FILE", help=f"skin.toml that gives {what}: a file, or one of {names} (default: the paper's)"
    )


def chosen_skin(arguments: argparse.Namespace) -> "Skin":
    """Return the skin that ``--skin`` names, or the paper's.

    Raises:
        MissingFileError: There is no such file.
        ValueError: It is no skin's description; the text names file and key.
    """
    from eitskin_proto.skin.skin import PAPER

    return PAPER if arguments.skin is None else read_skin(arguments.skin)


def read_skin(name: str) -> "Skin":
    """Return the skin of a file, or of one that comes with the package; as for :func:`chosen_skin`."""
    from eitskin_proto.skin.toml import load

    return load(files.find(name, files.SKIN))


def add_touches(parser: argparse.ArgumentParser, default: str, what: str = "touches that the bundle must know") -> None:
    """Declare ``--touches``.

    Args:
        parser: Of the command.
        default: What holds where nothing is said.
        what: What is said.
    """
    parser.add_argument(
        "--touches",
        choices=TOUCH_KINDS,
        help=f"{what}: lower (a finger on a hydrogel lowers conductance) or raise (as in the paper) "
        f"(default: {default})",
    )


def add_client_keys(parser: argparse.ArgumentParser) -> None:
    """Declare the keys with which a runtime is reached over TCP."""
    parser.add_argument("--server-key", type=Path, metavar="FILE", help="CURVE: server.key of the runtime")
    parser.add_argument("--client-key", type=Path, metavar="FILE", help="CURVE: our own .key_secret")


def client_keys(arguments: argparse.Namespace) -> "ClientKeys | None":
    """Return the keys that were named; None where none were.

    Raises:
        UsageError: One is missing.
    """
    from eitskin.messaging.curve_keys import load_client_keys

    if (arguments.server_key is None) != (arguments.client_key is None):
        raise UsageError("--server-key and --client-key need each other: give both")
    return None if arguments.server_key is None else load_client_keys(arguments.server_key, arguments.client_key)


def add_span(parser: argparse.ArgumentParser) -> None:
    """Declare ``--from`` and ``--to``, the part of a recording that a command takes."""
    parser.add_argument("--from", type=SPAN_S, dest="from_s", metavar="S", help="begin S seconds after the first frame")
    parser.add_argument("--to", type=SPAN_S, dest="to_s", metavar="S", help="end S seconds after the first frame")


def check_span(arguments: argparse.Namespace) -> None:
    """Refuse a part that ends before it begins.

    Raises:
        UsageError: It does.
    """
    begin_s, end_s = arguments.from_s, arguments.to_s
    if begin_s is not None and end_s is not None and begin_s >= end_s:
        raise UsageError(f"--from {begin_s:g} is not before --to {end_s:g}")


@dataclass(frozen=True, slots=True)
class ModeOption:
    """An option that does something in some ways of using a command only; declared with default None."""

    usual: Any
    """What holds where nothing was said."""
    ways: tuple[str, ...]
    """In which ways of using the command it does something."""


def settle(arguments: argparse.Namespace, way: str, options: Mapping[str, ModeOption]) -> None:
    """Give every option what holds where nothing was said, and refuse those that would do nothing.

    Args:
        arguments: They are changed.
        way: In which way the command is used, by the option that says so.
        options: By their names in ``arguments``.

    Raises:
        UsageError: One was named that does nothing in this way.
    """
    for name, option in options.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, option.usual)
        elif way not in option.ways:
            raise UsageError(
                f"{flag(name)} does nothing with {flag(way)}: leave it out; it works with {_listed(option.ways)}"
            )


def _listed(names: Iterable[str]) -> str:
    *first, last = (flag(name) for name in names)
    return f"{', '.join(first)} and {last}" if first else last
