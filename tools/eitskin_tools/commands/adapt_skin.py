"""``eitskin adapt-skin BUNDLE --skin calibrated.toml --out FILE``: trains a bundle further for one calibrated sheet.

It is a build (``eitskin build``) of few samples that begins with the bundle's network: stopped at any point, the same
command resumes. What presses recorded on the sheet itself teach is a bundle of its own (``eitskin teach``).
"""

import argparse
from dataclasses import replace

from eitskin_tools.command_line import files, options
from eitskin_tools.command_line.options import SEED
from eitskin_tools.command_line.parser import whole
from eitskin_tools.commands.build import add_making, make


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    from eitskin_tools.build import adaptation

    usual = adaptation.Adaptation()
    parser.add_argument("bundle", metavar="BUNDLE", help=f"a file, or one of {', '.join(files.BUNDLE.names())}")
    parser.add_argument(
        "--skin",
        required=True,
        metavar="FILE",
        help="calibrated description from 'eitskin calibrate'; devices are drawn from what it leaves uncertain",
    )
    for name, what in (
        ("deformations", "deformations to draw, each with a device,"),
        ("per_deformation", "touch sets at each deformation"),
        ("epochs", "training epochs"),
        ("seed", "seed of all draws"),
    ):
        default = getattr(usual, name)
        flag = f"--{name.replace('_', '-')}"
        kind = SEED if name == "seed" else whole(1)
        parser.add_argument(flag, type=kind, metavar="N", default=default, help=f"{what} (default {default})")
    add_making(parser)


def run(arguments: argparse.Namespace) -> int:
    """Adapt, and report."""
    from eitskin.model.bundle import load_bundle
    from eitskin.model.manifest import GENTLE
    from eitskin.model.skin_in_use import check_touches
    from eitskin_tools.build import adaptation

    chosen = {name: getattr(arguments, name) for name in ("deformations", "per_deformation", "epochs", "seed")}
    bundle = load_bundle(files.find(arguments.bundle, files.BUNDLE), lazily=True)
    twin, work = options.read_skin(arguments.skin), replace(adaptation.Adaptation(), **chosen)
    check_touches(bundle, twin)
    recipe = adaptation.adapted(bundle.path, twin, bundle.manifest, bundle.touch_kind, work, bundle.skin)
    gentle_of = bundle.path if GENTLE in bundle.beside else None
    return make(recipe, arguments, gentle_of=gentle_of)
