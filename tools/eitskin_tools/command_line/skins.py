"""``--skin``: the description that a command follows; the paper's skin where none is named."""

import argparse
from typing import TYPE_CHECKING

from eitskin_tools.command_line import files

if TYPE_CHECKING:
    from eitskin_proto.skin.skin import Skin


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


def chosen(arguments: argparse.Namespace) -> "Skin":
    """Return the skin that was named, or the paper's.

    Raises:
        MissingFileError: There is no such file.
        ValueError: It is no skin's description; the text names file and key.
    """
    from eitskin_proto.skin.skin import PAPER

    return PAPER if arguments.skin is None else read(arguments.skin)


def read(name: str) -> "Skin":
    """Return the skin of a file, or of one that comes with the package; as for :func:`chosen`."""
    from eitskin_proto.skin.toml import load

    return load(files.find(name, files.SKIN))
