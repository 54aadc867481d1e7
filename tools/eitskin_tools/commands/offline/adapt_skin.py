"""``eitskin adapt-skin BUNDLE --skin calibrated.toml --out FILE``: a bundle goes on learning on one sheet's own twin.

It is a build (``eitskin build``) of few samples that begins with the bundle's network: stopped at any point, the same
command goes on where it was.
"""

import argparse
from dataclasses import replace

from eitskin_tools.command_line import files, skins
from eitskin_tools.commands.offline.build import add_making, make
from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    from eitskin_tools.build import recipe as recipes

    usual = recipes.Adaptation()
    parser.add_argument("bundle", metavar="BUNDLE", help=f"a file, or one of {', '.join(files.BUNDLE.names())}")
    parser.add_argument(
        "--skin",
        required=True,
        metavar="FILE",
        help="what the sheet is, as 'eitskin calibrate' writes it; devices are drawn from what it leaves uncertain",
    )
    for name, what in (
        ("deformations", "devices and bends are drawn for"),
        ("per_deformation", "touch sets at each of them"),
        ("epochs", "of training"),
        ("seed", "where all draws come from"),
    ):
        default = getattr(usual, name)
        flag = f"--{name.replace('_', '-')}"
        parser.add_argument(flag, type=int, metavar="N", default=default, help=f"{what} (default {default})")
    add_making(parser)


def run(arguments: argparse.Namespace) -> int:
    """Adapt, and report."""
    from eitskin.model.bundle import load_bundle
    from eitskin_tools.build import recipe as recipes

    chosen = {name: getattr(arguments, name) for name in ("deformations", "per_deformation", "epochs", "seed")}
    for name, value in chosen.items():
        if value < (0 if name == "seed" else 1):
            raise UsageError(f"--{name.replace('_', '-')} is {value}, expected at least {0 if name == 'seed' else 1}")
    bundle = load_bundle(files.find(arguments.bundle, files.BUNDLE), lazily=True)
    twin, work = skins.read(arguments.skin), replace(recipes.Adaptation(), **chosen)
    return make(recipes.adapted(bundle.path, twin, bundle.manifest, bundle.touch_kind, work), arguments)
