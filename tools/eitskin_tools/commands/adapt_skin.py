"""``eitskin adapt-skin BUNDLE --skin calibrated.toml --out FILE``: trains a bundle further for one calibrated sheet.

It is a build (``eitskin build``) of few samples that begins with the bundle's network: stopped at any point, the same
command resumes. It can train on presses recorded on the sheet itself at the end; it prints their benefit, and keeps the
network without them if that is better.
"""

import argparse
from dataclasses import replace
from typing import Any

from eitskin_proto.errors import SkinError
from eitskin_tools.command_line import files, options
from eitskin_tools.command_line.options import SEED
from eitskin_tools.command_line.parser import whole
from eitskin_tools.commands.build import add_making, make
from eitskin_tools.errors import UsageError


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
    parser.add_argument(
        "--presses",
        metavar="FILE",
        help="presses of a stamp recorded on the sheet, as 'eitskin calibrate' reads them; also train on these",
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
    if arguments.presses is None:
        return make(recipe, arguments, gentle_of=gentle_of)
    recording, identity = _recorded(arguments.presses, twin, bundle)
    return make(replace(recipe, presses=identity), arguments, presses=recording, gentle_of=gentle_of)


def _recorded(name: str, twin: Any, bundle: Any) -> tuple[Any, str]:
    """Return a recording whose presses agree with each other, the skin and the bundle, and the id of its file.

    Raises:
        SkinError: It cannot be read, or learned from; in one line.
    """
    from eitskin_proto.files.digest import id_of
    from eitskin_proto.files.reading import read_bytes
    from eitskin_sim.calibration.recording import LARGEST_FILE, RecordingError, load_recording
    from eitskin_training.samples.presses import check, check_ways

    if bundle.labels != "area":
        raise UsageError(
            "--presses: a bundle of units cannot learn from presses, because presses lie anywhere, not on units"
        )
    path = files.find(name, files.CALIBRATION_RECORDING)
    recording = load_recording(path, twin)
    try:
        check(recording)
        check_ways(recording, twin, bundle.touch_kind, f"bundle {bundle.path.stem}")
    except SkinError as error:
        raise RecordingError(f"{path}: {error}") from error
    return recording, id_of(read_bytes(path, LARGEST_FILE))
