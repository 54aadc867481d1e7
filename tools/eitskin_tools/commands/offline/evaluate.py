"""``eitskin evaluate``: score a solver on phantoms, on drawn trials, and on what was measured."""

import argparse
import json
import os
import sys
import time
from dataclasses import asdict, replace
from typing import Any

from eitskin_tools.command_line import files, skins
from eitskin_tools.command_line.suggest import expected_one_of
from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommand's arguments."""
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
        default="vd2t",
        help="vd2t, vd2t-int8, vd2t-small, verified (vd2t, checked by physics), tikhonov, l1 or sbl; the last three "
        "take the grid of the phantoms' labels, or the one that -pixels or -units names (default: vd2t)",
    )
    parser.add_argument(
        "--all",
        "--markdown",
        dest="all",
        action="store_true",
        help="with --phantoms: every solver and reference as Markdown, beside the paper's Table II",
    )
    parser.add_argument("--noise", default="N2", choices=("N1", "N2", "N3", "none"), help="default: N2")
    parser.add_argument("--snr-db", type=float, default=50.0, metavar="S", help="default: 50")
    parser.add_argument(
        "--reference",
        choices=("pre", "post", "predicted"),
        help="what the voltages are compared with: the flat sheet, the bent sheet, or V_pred from its cloud (default: "
        "post for the classical solvers; a network takes pre by design, and V_pred besides if its head has that input)",
    )
    parser.add_argument("--seeds", type=int, default=1, metavar="K", help="noise draws for each phantom (default: 1)")
    parser.add_argument(
        "--shift-px", type=float, default=0.0, metavar="P", help="move every touch by up to P pixels, at random"
    )
    parser.add_argument(
        "--bundle",
        type=files.bundle,
        metavar="FILE",
        help=f"{files.A_BUNDLE}, with the network (default: the one with the same labels)",
    )
    parser.add_argument(
        "--picture", metavar="FILE.png", help="with --phantoms: truth and every solver's map on the bent surface"
    )
    _add_ablations(parser)
    _add_trials(parser)
    skins.add_skin(
        parser, "model, map and clouds of the solvers, and the sheet of trials and of what phantoms leave out"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _add_ablations(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("ablations")
    group.add_argument(
        "--prediction",
        default="scan",
        choices=("scan", "none", "true"),
        help="second input of a network's head: V_pred of the cloud, nothing, or the true untouched voltages",
    )
    group.add_argument(
        "--cloud",
        default="scan",
        choices=("scan", "flat", "other"),
        help="the shape that solvers are told: as measured, flat, or that of another deformation (default: scan)",
    )


def _add_trials(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("trials")
    group.add_argument("--family", default="A", choices=("A", "B"), help="where deformations are drawn (default: A)")
    group.add_argument("--deformations", type=int, default=20, metavar="N", help="how many (default: 20)")
    group.add_argument("--each", type=int, default=5, metavar="N", help="touch sets at each of them (default: 5)")
    group.add_argument(
        "--labels",
        default=None,
        choices=("units", "area"),
        help="of --random and --untouched: touches on the unit grid or anywhere (default: area)",
    )

    devices = parser.add_argument_group("devices")
    devices.add_argument("--draws", type=int, default=3, metavar="N", help="devices of each mismatch (default: 3)")
    devices.add_argument("--seed", type=int, default=0, metavar="S", help="names the devices drawn (default: 0)")
    every = "mm,units,single,press04,press06"
    devices.add_argument("--trials", default=every, metavar="A,B", help="which trials (default: all five)")
    drifts = "left in, or taken out as the runtime does: met after a start, or followed since the reference"
    devices.add_argument("--drift", choices=("left", "met", "followed"), default="left", help=drifts)
    contrast = "of --single: conductivity over the sheet's, below 1 for a press (default: 50)"
    group.add_argument("--contrast", type=float, metavar="C", help=contrast)
    group.add_argument("--border", type=float, metavar="MM", help="of --single: width of a graded border (default: 0)")
    group.add_argument("--disc", action="store_true", help="of --single: a disc, not a square")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate, and print an object or a table."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is first imported, below
    from eitskin_sim.evaluation.harness import Conditions
    from eitskin_tools.evaluation.solvers import NAMES, Request

    if arguments.seeds < 1:
        raise UsageError(f"--seeds {arguments.seeds}: expected at least 1")
    if arguments.solver not in NAMES:
        raise UsageError(expected_one_of("--solver", arguments.solver, NAMES))
    if not 0.0 <= arguments.shift_px <= 1.0:
        raise UsageError(f"--shift-px {arguments.shift_px:g}: expected from 0 to 1")
    if arguments.all and arguments.phantoms is None:
        raise UsageError("--all needs --phantoms: the table stands beside the paper's")
    skin = skins.chosen(arguments)
    conditions = Conditions(
        arguments.noise, arguments.snr_db, arguments.seeds, arguments.shift_px, arguments.cloud, skin
    )
    request = Request(arguments.solver, arguments.reference, arguments.bundle, arguments.prediction)
    if arguments.picture is not None and (arguments.phantoms is None or arguments.all or arguments.shift_px):
        raise UsageError("--picture needs --phantoms, and neither --all nor --shift-px")
    _softness(arguments)
    if arguments.drift != "left" and arguments.devices is None:
        raise UsageError(f"--drift {arguments.drift} needs --devices: nothing else drifts")
    if arguments.measured is not None:
        return _measured(arguments, request)
    if arguments.tank is not None:
        return _tank(arguments)
    if arguments.devices is not None:
        return _devices(arguments, request)
    if arguments.phantoms is None:
        return _trial(arguments, request, conditions)
    return _phantoms(arguments, request, conditions)


def _measured(arguments: argparse.Namespace, request: Any) -> int:
    from eitskin_tools.evaluation.measured import evaluate_measured, table
    from eitskin_tools.evaluation.measured_file import load_measured

    if arguments.shift_px or arguments.cloud != "scan":
        raise UsageError("--shift-px and --cloud do not go with --measured: its scans and its truth are what they are")
    measured = load_measured(files.find(arguments.measured, files.MEASURED), skins.chosen(arguments))
    if measured.ending:
        print(f"eitskin evaluate: {arguments.measured}{measured.ending}", file=sys.stderr)
    found = evaluate_measured(measured, request, _progress())
    print(json.dumps(found) if arguments.json else table(found))
    return 0


def _devices(arguments: argparse.Namespace, request: Any) -> int:
    from eitskin_sim.evaluation.devices import runs
    from eitskin_tools.evaluation.devices import evaluate_devices, meant, rows_of, table, trials_of

    if arguments.draws < 1 or arguments.seed < 0:
        raise UsageError(f"--draws {arguments.draws} --seed {arguments.seed}: expected at least 1, and at least 0")
    rows = rows_of(arguments.devices)
    skin = skins.chosen(arguments)
    drawn = meant(skin)
    kinds = trials_of(arguments.trials.split(","), arguments.deformations, arguments.each, drawn)
    plan = runs.Plan(arguments.draws, 0, arguments.seed, arguments.noise, arguments.snr_db, skin, drawn)
    found = evaluate_devices(rows, kinds, request, plan, _progress(), arguments.drift)
    print(json.dumps(found) if arguments.json else table(found))
    return 0


def _tank(arguments: argparse.Namespace) -> int:
    from eitskin_tools.evaluation.tank import evaluate_tank, table

    skin = None if arguments.skin is None else skins.chosen(arguments)
    found = evaluate_tank(files.find(arguments.tank, files.TANK), _progress(), skin)
    print(json.dumps(found) if arguments.json else table(found))
    return 0


def _phantoms(arguments: argparse.Namespace, request: Any, conditions: Any) -> int:
    from eitskin_sim.scene.scene import load_phantoms
    from eitskin_tools.evaluation.paper_tables import comparison
    from eitskin_tools.evaluation.printed import print_report
    from eitskin_tools.evaluation.solvers import evaluate_requests

    phantoms = load_phantoms(files.find(arguments.phantoms, files.PHANTOMS), conditions.skin)
    if not phantoms:
        raise ValueError(f"{arguments.phantoms} holds no phantom; expected a list of at least one")
    if arguments.all:
        table, reports = comparison(phantoms, conditions, _progress(), arguments.bundle)
        print(json.dumps({"table": table, "reports": reports}) if arguments.json else table)
        return 0
    if arguments.picture is not None:
        files.picture(arguments.picture)
        from eitskin_tools.evaluation.gallery import collect, draw

        rows = collect(phantoms, conditions, arguments.bundle)
        draw(rows, arguments.picture)
        found = {"picture": str(arguments.picture), "phantoms": len(rows)}
        print(json.dumps(found) if arguments.json else f"{arguments.picture}: {len(rows)} phantoms")
        return 0
    (found,) = evaluate_requests(phantoms, [request], conditions, _progress())
    if arguments.json:
        print(json.dumps(found))
    else:
        print_report(found)
    return 0


def _trial(arguments: argparse.Namespace, request: Any, conditions: Any) -> int:
    from eitskin_sim.evaluation import trials
    from eitskin_tools.evaluation.printed import print_trial
    from eitskin_tools.evaluation.trial_runs import touched_trial, untouched_trial

    family, deformations, each = arguments.family, arguments.deformations, arguments.each
    labels: trials.Labels = arguments.labels or "area"
    if arguments.labels == "units" and (arguments.single or arguments.pair):
        raise UsageError("--labels units: --single and --pair lie anywhere; leave it out")
    trial: dict[str, Any] = {"family": family, "n_deformations": deformations, "each": each, "labels": labels}
    softness = _softness(arguments)
    if arguments.untouched:
        found = untouched_trial(deformations, family, labels, request, conditions, _progress())
        return print_trial({"trial": {"kind": "untouched", **trial, "each": 1}, **found}, arguments.json)
    if arguments.single is not None:
        trial = {"kind": "single", "size_mm": arguments.single, **asdict(softness), **trial}
        phantoms = trials.single(arguments.single, deformations, each, family, softness, conditions.skin)
    elif arguments.pair is not None:
        trial = {"kind": "pair", "gap_mm": arguments.pair, **trial}
        phantoms = trials.pair(arguments.pair, deformations, each, family, conditions.skin)
    else:
        counts = _counts(arguments.random)
        trial = {"kind": "random", "touches": list(counts), **trial}
        phantoms = trials.random(counts, deformations, each, family, labels, conditions.skin)
    found = touched_trial(phantoms, each, request, conditions, _progress())
    return print_trial({"trial": trial, **found}, arguments.json)


def _softness(arguments: argparse.Namespace) -> Any:
    from eitskin_sim.evaluation.trials import HARD

    asked = {"contrast": arguments.contrast, "border_mm": arguments.border, "disc": arguments.disc or None}
    given = {name: value for name, value in asked.items() if value is not None}
    if given and arguments.single is None:
        raise UsageError("--contrast, --border and --disc belong to --single; phantoms say it in their scenes")
    return replace(HARD, **given)


def _counts(text: str) -> tuple[int, int]:
    low, _, high = text.partition("-")
    if not (low.isdecimal() and (high or low).isdecimal()):
        raise UsageError(f"--random {text!r}: expected a number of touches or a range, such as 2-4")
    return int(low), int(high or low)


def _progress() -> Any:
    """A line on stderr where a person looks on, nothing elsewhere."""
    if not sys.stderr.isatty():
        return None
    start = time.monotonic()

    def show(done: int, total: int) -> None:
        left = (time.monotonic() - start) / done * (total - done)
        print(
            f"\r{done} of {total}, {left:.0f} s left ", end="\n" if done == total else "", file=sys.stderr, flush=True
        )

    return show
