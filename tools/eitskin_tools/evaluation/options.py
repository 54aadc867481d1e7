"""The options of ``eitskin evaluate``, and the mode to which each belongs."""

import argparse
from typing import Final

from eitskin_tools.command_line import options
from eitskin_tools.command_line.options import SNR_DB, ModeOption, settle
from eitskin_tools.command_line.parser import Parser, whole, within

TOUCHED_TRIALS: Final = ("single", "pair", "random")
TRIALS: Final = (*TOUCHED_TRIALS, "untouched")
SUBJECTS: Final = ("phantoms", *TRIALS, "measured", "tank", "devices")
"""What can be evaluated; each is an option, and one of them is given."""

SIMULATED_SUBJECTS: Final = ("phantoms", *TRIALS)
SOLVER_SUBJECTS: Final = (*SIMULATED_SUBJECTS, "measured", "devices")
"""Where a solver is named, a network's too."""

MODE_OPTIONS: Final = {
    "solver": ModeOption(None, (*SOLVER_SUBJECTS, "tank")),
    "reference": ModeOption(None, SOLVER_SUBJECTS),
    "bundle": ModeOption(None, SOLVER_SUBJECTS),
    "prediction": ModeOption("scan", SOLVER_SUBJECTS),
    "noise": ModeOption("N2", (*SIMULATED_SUBJECTS, "devices")),
    "snr_db": ModeOption(50.0, (*SIMULATED_SUBJECTS, "devices")),
    "seeds": ModeOption(1, SIMULATED_SUBJECTS),
    "shift_px": ModeOption(0.0, SIMULATED_SUBJECTS),
    "cloud": ModeOption("scan", SIMULATED_SUBJECTS),
    "at_rest": ModeOption(0, SIMULATED_SUBJECTS),
    "fused": ModeOption(1, SIMULATED_SUBJECTS),
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


def add_arguments(parser: Parser) -> None:
    """Add the arguments of ``eitskin evaluate``; those of some ways only are None until :func:`way_of`."""
    parser.usage = "eitskin evaluate WHAT [options]"
    what = parser.add_argument_group("what to evaluate").add_mutually_exclusive_group(required=True)
    what.add_argument("--phantoms", metavar="FILE", help="JSON list of phantoms: a file, paper_units or paper_mm")
    what.add_argument("--single", type=float, metavar="MM", help="one touch of this size, anywhere; a hard square")
    what.add_argument("--pair", type=float, metavar="MM", help="two 10 mm touches this far apart, edge to edge")
    what.add_argument("--random", metavar="K-L", help="K to L random touches, such as 2-4")
    what.add_argument("--untouched", action="store_true", help="bent sheets without a touch")
    what.add_argument(
        "--devices", metavar="NAME", help="sheets unlike the nominal one: lab, random, single, drift, FILE"
    )
    what.add_argument("--measured", metavar="FILE", help="your own samples (docs/evaluation.md), .npz or .mcap")
    what.add_argument("--tank", metavar="FILE.npz", help="frames of a round tank: objects by sector and sign")
    parser.add_argument(
        "--solver",
        help="vd2t, vd2t-int8, vd2t-small, verified (vd2t checked by physics), tikhonov, l1 or sbl; the last three "
        "solve for units or pixels as the labels do, or by name: l1-pixels (default: vd2t; --tank and bundles without "
        "a network: l1)",
    )
    options.add_bundle(parser, "with the network (default: the shipped one with the same labels)")
    options.add_skin(parser, "the sheet of trials and the solvers' model")
    parser.add_argument(
        "--noise",
        choices=("N1", "N2", "N3", "none"),
        help="noise in proportion to the voltages' change (N1), to each voltage (N2) or to their rms (N3); default: N2",
    )

    group = parser.add_more("trials")
    group.add_argument("--deformations", type=whole(1), metavar="N", help="number of deformations (default: 20)")
    group.add_argument("--each", type=whole(1), metavar="N", help="touch sets at each deformation (default: 5)")
    group.add_argument(
        "--seed",
        type=whole(0),
        metavar="S",
        help="which draw of deformations, touches and noise, or of devices (default: 0)",
    )
    group.add_argument(
        "--family", choices=("A", "B"), help="family of deformations; B was never trained on (default: A)"
    )
    group.add_argument(
        "--labels", choices=("units", "area"), help="--random, --untouched: touches on the unit grid or anywhere (area)"
    )
    group.add_argument(
        "--contrast", type=float, metavar="C", help="--single: conductivity over the sheet's, below 1 lowers it (50)"
    )
    group.add_argument("--border", type=float, metavar="MM", help="--single: width of a graded border (default: 0)")
    group.add_argument("--disc", action="store_true", default=None, help="--single: a disc instead of a square")

    group = parser.add_more("noise and reference")
    group.add_argument("--snr-db", type=SNR_DB, metavar="S", help="signal to noise ratio in dB (default: 50)")
    group.add_argument("--seeds", type=whole(1), metavar="K", help="noise draws for each phantom (default: 1)")
    group.add_argument(
        "--shift-px", type=within(0.0, 1.0), metavar="P", help="move every touch by up to P pixels, at random"
    )
    group.add_argument(
        "--reference",
        choices=("pre", "post", "predicted"),
        help="compare the voltages with the flat sheet (pre), with the bent sheet (post) or with V_pred (predicted); "
        "default: post for classical solvers, pre for networks, which also have V_pred",
    )
    group.add_argument(
        "--at-rest", type=whole(0), metavar="N", help="verified: first show N untouched frames of each deformation (0)"
    )
    group.add_argument("--fused", type=whole(1), metavar="N", help="average N frames of each touch at rest (1)")

    group = parser.add_more("ablations")
    group.add_argument(
        "--prediction",
        choices=("scan", "none"),
        help="the network's second input: V_pred of the scan, or nothing (default: scan)",
    )
    group.add_argument(
        "--cloud",
        choices=("scan", "fitted", "flat", "other"),
        help="the shape that solvers are given: as measured, none (verified fits it to frames), flat, or of another "
        "deformation (default: scan)",
    )

    group = parser.add_more("devices")
    group.add_argument("--draws", type=whole(1), metavar="N", help="devices of each mismatch (default: 3)")
    group.add_argument("--trials", metavar="A,B", help="mm, units, single, press04, press06 (default: all)")
