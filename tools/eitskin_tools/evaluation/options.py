"""What ``eitskin evaluate`` takes, and which option belongs to which way of evaluating."""

import argparse
from typing import Final

from eitskin_tools.command_line import options
from eitskin_tools.command_line.options import ModeOption, settle

TOUCHED_TRIALS: Final = ("single", "pair", "random")
TRIALS: Final = (*TOUCHED_TRIALS, "untouched")
SUBJECTS: Final = ("phantoms", *TRIALS, "measured", "tank", "devices")
"""What can be evaluated; each is an option, and one of them is given."""

SIMULATED_SUBJECTS: Final = ("phantoms", *TRIALS)
SOLVER_SUBJECTS: Final = (*SIMULATED_SUBJECTS, "measured", "devices")
"""Where a solver is named, a network's too."""

MODE_OPTIONS: Final = {
    "solver": ModeOption("vd2t", (*SOLVER_SUBJECTS, "tank"), {"tank": "tikhonov"}),
    "reference": ModeOption(None, SOLVER_SUBJECTS),
    "bundle": ModeOption(None, SOLVER_SUBJECTS),
    "prediction": ModeOption("scan", SOLVER_SUBJECTS),
    "noise": ModeOption("N2", (*SIMULATED_SUBJECTS, "devices")),
    "snr_db": ModeOption(50.0, (*SIMULATED_SUBJECTS, "devices")),
    "seeds": ModeOption(1, SIMULATED_SUBJECTS),
    "shift_px": ModeOption(0.0, SIMULATED_SUBJECTS),
    "cloud": ModeOption("scan", SIMULATED_SUBJECTS),
    "at_rest": ModeOption(0, SIMULATED_SUBJECTS),
    "family": ModeOption("A", TRIALS),
    "deformations": ModeOption(20, (*TRIALS, "devices")),
    "each": ModeOption(5, (*TOUCHED_TRIALS, "devices")),
    "labels": ModeOption("area", ("random", "untouched")),
    "contrast": ModeOption(None, ("single",)),
    "border": ModeOption(None, ("single",)),
    "disc": ModeOption(None, ("single",)),
    "draws": ModeOption(3, ("devices",)),
    "seed": ModeOption(0, (*TRIALS, "devices")),
    "trials": ModeOption("mm,units,single,press04,press06", ("devices",)),
    "drift": ModeOption("left", ("devices",)),
}
"""Every option that does something in some ways only."""


def way_of(arguments: argparse.Namespace) -> str:
    """Return what is evaluated, one of :data:`SUBJECTS`, once every option has what holds.

    Raises:
        UsageError: An option was named that does nothing there.
    """
    way = next(
        name for name in SUBJECTS if getattr(arguments, name) is not None and getattr(arguments, name) is not False
    )
    settle(arguments, way, MODE_OPTIONS)
    return way


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``eitskin evaluate``; what belongs to some ways only is None until :func:`way_of`."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--phantoms", metavar="FILE", help="JSON list of phantoms: a file, paper_units or paper_mm")
    what.add_argument(
        "--single", type=float, metavar="MM", help="trial: one touch of this size, anywhere; a hard square"
    )
    what.add_argument("--pair", type=float, metavar="MM", help="trial: two 10 mm touches this far apart, edge to edge")
    what.add_argument("--random", metavar="K-L", help="trial: K to L random touches, such as 2-4 or 5-6")
    what.add_argument("--untouched", action="store_true", help="trial: bent sheets with no touch at all")
    what.add_argument(
        "--measured", metavar="FILE.npz", help="samples that somebody measured (docs/evaluation.md), or FILE.mcap"
    )
    what.add_argument("--tank", metavar="FILE.npz", help="frames of a round tank: objects by sector and sign")
    what.add_argument(
        "--devices", metavar="NAME", help="trials on devices unlike the nominal one: lab, random, single, drift or FILE"
    )
    parser.add_argument(
        "--solver",
        help="vd2t, vd2t-int8, vd2t-small, verified (vd2t, checked by physics), tikhonov, l1 or sbl (default: vd2t; "
        "with --tank, tikhonov); the last three serve --tank, too, and solve for pixels or units, whichever the labels "
        "are of, or, with -pixels or -units behind the name, as in tikhonov-units, always for these",
    )
    parser.add_argument(
        "--noise",
        choices=("N1", "N2", "N3", "none"),
        help="noise in proportion to the voltages' change (N1), to each voltage (N2), to their rms (N3); default: N2",
    )
    parser.add_argument("--snr-db", type=float, metavar="S", help="signal to noise ratio in dB (default: 50)")
    parser.add_argument(
        "--reference",
        choices=("pre", "post", "predicted"),
        help="what the voltages are compared with: the flat sheet, the bent sheet, or V_pred from its cloud (default: "
        "post for the classical solvers; a network takes pre by design, and V_pred besides if its head has that input)",
    )
    parser.add_argument("--seeds", type=int, metavar="K", help="noise draws for each phantom (default: 1)")
    parser.add_argument("--shift-px", type=float, metavar="P", help="move every touch by up to P pixels, at random")
    options.add_bundle(parser, "with the network (default: the one with the same labels)")
    _add_ablations(parser)
    _add_trials(parser)
    options.add_skin(
        parser, "model, map and clouds of the solvers, and the sheet of trials and of what phantoms leave out"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _add_ablations(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("ablations")
    group.add_argument(
        "--prediction",
        choices=("scan", "none", "true"),
        help="second input of a network's head: V_pred of the cloud, nothing, or the true untouched voltages (default: "
        "scan)",
    )
    group.add_argument(
        "--cloud",
        choices=("scan", "flat", "other"),
        help="the shape that solvers are told: as measured, flat, or that of another deformation (default: scan)",
    )
    group.add_argument(
        "--at-rest",
        type=int,
        metavar="N",
        help="with --solver verified: physics first sees N frames of each deformation untouched (default: 0)",
    )


def _add_trials(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("trials")
    group.add_argument("--family", choices=("A", "B"), help="where deformations are drawn (default: A)")
    group.add_argument("--deformations", type=int, metavar="N", help="how many (default: 20)")
    group.add_argument(
        "--seed",
        type=int,
        metavar="S",
        help="which draw of deformations, touches and noise, or of devices (default: 0)",
    )
    group.add_argument("--each", type=int, metavar="N", help="touch sets at each of them (default: 5)")
    group.add_argument(
        "--labels",
        choices=("units", "area"),
        help="of --random and --untouched: touches on the unit grid or anywhere (default: area)",
    )
    contrast = "of --single: conductivity over the sheet's, below 1 for a press (default: 50)"
    group.add_argument("--contrast", type=float, metavar="C", help=contrast)
    group.add_argument("--border", type=float, metavar="MM", help="of --single: width of a graded border (default: 0)")
    group.add_argument("--disc", action="store_true", default=None, help="of --single: a disc, not a square")

    devices = parser.add_argument_group("devices")
    devices.add_argument("--draws", type=int, metavar="N", help="devices of each mismatch (default: 3)")
    devices.add_argument("--trials", metavar="A,B", help="which trials (default: all five)")
    drifts = "left in, or taken out as the runtime does: met after a start, or followed since the reference"
    devices.add_argument("--drift", choices=("left", "met", "followed"), help=drifts)
