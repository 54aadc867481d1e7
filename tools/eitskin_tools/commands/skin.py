"""``eitskin skin show|check FILE``: prints a skin's description, or checks whether such a sheet is possible.

``show`` prints the whole description as TOML, what is left out of the file as well, under a head of comments; so what
it prints is a skin.toml. ``check`` also places the electrodes on the sheet, and prints one line.
"""

import argparse
from dataclasses import asdict, fields
from typing import Any

from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.symmetry import Image, images
from eitskin_proto.skin.toml import TABLES, to_toml
from eitskin_tools.command_line import files, needs, options
from eitskin_tools.console.terminal import answer

ACTIONS = ("show", "check")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("action", choices=ACTIONS, help="show prints the whole description, check one line")
    parser.add_argument("file", metavar="FILE", help=f"a skin.toml, or one of {', '.join(files.SKIN.names())}")


def run(arguments: argparse.Namespace) -> int:
    """Show or check the description."""
    skin = options.read_skin(arguments.file)
    if arguments.action == "check":
        needs.require("skin check", ("scipy",))
        from eitskin_sim.devices.possible import check_skin

        try:
            check_skin(skin)
        except ValueError as error:
            raise ValueError(f"{arguments.file}: {error}") from error
    found = _summary(skin)
    lines = [*(f"# {name:<14} {text}" for name, text in found.items()), to_toml(skin)]
    if arguments.action == "check":
        lines = [
            f"{arguments.file}: {skin.name}, {found['sheet']}, digest {skin.digest}, images {found['mirror images']}"
        ]
    return answer(arguments, _report(arguments.file, skin), *lines)


def _summary(skin: Skin) -> dict[str, str]:
    grid, own = skin.grid, images(skin)
    dx, dy = grid.pixel_mm
    return {
        "digest": skin.digest,
        "grid_id": skin.grid_id,
        "sheet": f"{skin.outline.kind} of {grid.size_mm[0]:g} x {grid.size_mm[1]:g} mm",
        "pixels": f"{grid.shape[0]} rows x {grid.shape[1]} columns of {dx:.4g} x {dy:.4g} mm",
        "units": f"{grid.units[0]} rows x {grid.units[1]} columns",
        "mirror images": f"{len(own)} ({', '.join(map(_named, own))})",
        "touches": f"{'raise or lower' if skin.touch_kind == 'both' else skin.touch_kind} conductance",
        "not exact": ", ".join(_uncertain(skin)) or "nothing",
    }


def _named(image: Image) -> str:
    return {(False, False): "itself", (True, False): "x", (False, True): "y", (True, True): "x and y"}[image.x, image.y]


def _uncertain(skin: Skin) -> list[str]:
    """Return the keys whose values the file says are uncertain."""
    found = []
    for table in TABLES:
        part = getattr(skin, table)
        for one in fields(part):
            value = getattr(part, one.name)
            if isinstance(value, Quantity) and value.law != "exact" and value.spread > 0.0:
                found.append(f"{table}.{one.name}")
    return found


def _report(file: str, skin: Skin) -> dict[str, Any]:
    own = images(skin)
    return {
        "file": str(file),
        "digest": skin.digest,
        "grid_id": skin.grid_id,
        "touch_kind": skin.touch_kind,
        "mirror_images": [{"x": one.x, "y": one.y, "electrodes": list(one.electrodes)} for one in own],
        "not_exact": _uncertain(skin),
        "description": asdict(skin),
    }
