"""``eitskin evaluate``: score a solver on phantoms, on drawn trials, and on what was measured."""

import argparse
import json
import os
import sys
from dataclasses import asdict, replace
from typing import Any

from eitskin_tools.command_line import files, options
from eitskin_tools.command_line.parser import expected_one_of
from eitskin_tools.console.progress import ProgressBar
from eitskin_tools.console.terminal import answer, note
from eitskin_tools.errors import UsageError
from eitskin_tools.evaluation.options import MODE_OPTIONS, SIMULATED_SUBJECTS, add_arguments, way_of

__all__ = ["add_arguments", "run"]


def run(arguments: argparse.Namespace) -> int:
    """Evaluate, and print an object or a table."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is first imported, below
    from eitskin_sim.evaluation.harness import Conditions
    from eitskin_tools.evaluation.solvers import NAMES, Request, usual_solver

    way = way_of(arguments)
    if arguments.solver is None:
        arguments.solver = "l1" if way == "tank" else usual_solver(arguments.bundle)
    if arguments.solver not in NAMES:
        raise UsageError(expected_one_of("--solver", arguments.solver, NAMES))
    skin = options.chosen_skin(arguments)
    conditions = Conditions(
        arguments.noise,
        arguments.snr_db,
        arguments.seeds,
        arguments.shift_px,
        arguments.cloud,
        skin,
        arguments.seed * arguments.seeds,
        arguments.fused,
    )
    request = Request(arguments.solver, arguments.reference, arguments.bundle, arguments.prediction, arguments.at_rest)
    _check_classical(arguments, way, request)
    slow = way == "measured" and arguments.solver == "verified"
    with ProgressBar(way, lines=slow) as bar:
        arguments.progress = bar.show
        if way == "measured":
            return _measured(arguments, request)
        if way == "tank":
            return _tank(arguments)
        if way == "devices":
            return _devices(arguments, request)
        if way == "phantoms":
            return _phantoms(arguments, request, conditions)
        return _trial(arguments, request, conditions)


def _check_classical(arguments: argparse.Namespace, way: str, request: Any) -> None:
    """Tell of a bundle that a classical solver does not read, and refuse a prediction; elsewhere its gate judges.

    A caller that goes through all solvers may name a bundle for each.
    """
    from eitskin_tools.evaluation.solvers import is_deployed

    if way not in SIMULATED_SUBJECTS or is_deployed(request):
        return
    said = f"does nothing with --solver {arguments.solver}, which is made of the skin alone"
    if arguments.prediction != MODE_OPTIONS["prediction"].usual:
        raise UsageError(f"--prediction {said}: leave it out")
    if arguments.bundle is not None:
        note(f"eitskin evaluate: --bundle {said}")


def _measured(arguments: argparse.Namespace, request: Any) -> int:
    from eitskin_tools.evaluation.measured import evaluate_measured, table, touches_of
    from eitskin_tools.evaluation.measured_file import load_measured

    path = files.find(arguments.measured, files.MEASURED)
    if (status := _taught(arguments, path)) is not None:
        return status
    measured = load_measured(path, options.chosen_skin(arguments))
    if measured.ending:
        print(f"eitskin evaluate: {arguments.measured}{measured.ending}", file=sys.stderr)
    if measured.touch_kind or touches_of(measured) == "lower":  # raising ones are also where nothing is said
        _tell_unknown(request, [("area", touches_of(measured))])
    found = evaluate_measured(measured, request, arguments.progress)
    return answer(arguments, found, table(found))


def _taught(arguments: argparse.Namespace, path: Any) -> int | None:
    """Evaluate a taught bundle on its kind of file, and return the exit status; None for any other bundle."""
    from eitskin.model.bundle import load_bundle
    from eitskin_tools.teach.presses import is_presses, load_presses

    bundle = load_bundle(arguments.bundle, lazily=True) if arguments.bundle is not None else None
    if bundle is None or not bundle.taught_arrays():
        if is_presses(path):
            raise UsageError(f"{path} holds presses: name a bundle of 'eitskin teach' with --bundle")
        return None
    from eitskin_tools.evaluation.taught import evaluate_taught, table

    found = evaluate_taught(load_presses(path), bundle)
    return answer(arguments, found, table(found))


def _devices(arguments: argparse.Namespace, request: Any) -> int:
    from eitskin_sim.evaluation import device_runs as runs
    from eitskin_tools.evaluation.devices import KINDS, evaluate_devices, meant, rows_of, table, trials_of

    kinds = arguments.trials.split(",")
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise UsageError(expected_one_of("--trials", unknown[0], KINDS))
    rows = rows_of(arguments.devices)
    skin = options.chosen_skin(arguments)
    drawn = meant(skin)
    trials = trials_of(kinds, arguments.deformations, arguments.each, drawn)
    plan = runs.Plan(arguments.draws, 0, arguments.seed, arguments.noise, arguments.snr_db, skin, drawn)
    _tell_unknown(request, [(one.labels, "lower" if one.lowering else "raise") for one in trials])
    found = evaluate_devices(rows, trials, request, plan, arguments.progress)
    return answer(arguments, found, table(found))


def _tank(arguments: argparse.Namespace) -> int:
    from eitskin_tools.evaluation.tank import SOLVERS, evaluate_tank, table

    if arguments.solver not in SOLVERS:
        raise UsageError(expected_one_of("with --tank, --solver", arguments.solver, SOLVERS))
    skin = None if arguments.skin is None else options.chosen_skin(arguments)
    found = evaluate_tank(files.find(arguments.tank, files.TANK), arguments.progress, skin, arguments.solver)
    return answer(arguments, found, table(found))


def _phantoms(arguments: argparse.Namespace, request: Any, conditions: Any) -> int:
    from eitskin_tools.evaluation.printed import print_report
    from eitskin_tools.evaluation.solvers import evaluate_requests

    phantoms = _loaded(arguments.phantoms, conditions.skin)
    _tell_unknown(request, [(one.truth, one.scene.touch_kind) for one in phantoms if one.scene.touches])
    (found,) = evaluate_requests(phantoms, [request], conditions, arguments.progress)
    _tell_unlike(found)
    if arguments.json:
        print(json.dumps(found))
    else:
        print_report(found)
    return 0


def _loaded(name: str, skin: Any) -> Any:
    """Return the phantoms of a file, each with a truth on the map of a skin."""
    from eitskin_sim.evaluation.truth import check_truths
    from eitskin_sim.scene.scene import SceneError, load_phantoms

    path = files.find(name, files.PHANTOMS)
    phantoms = load_phantoms(path, skin)
    if not phantoms:
        raise ValueError(f"{name} holds no phantom; expected a list of at least one")
    try:
        check_truths(phantoms, skin)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    return phantoms


def _trial(arguments: argparse.Namespace, request: Any, conditions: Any) -> int:
    from eitskin_sim.evaluation import trials
    from eitskin_tools.evaluation.printed import print_trial
    from eitskin_tools.evaluation.solvers import touched_trial, untouched_trial

    family, deformations, each = arguments.family, arguments.deformations, arguments.each
    labels: trials.Labels = arguments.labels
    trial: dict[str, Any] = {"family": family, "n_deformations": deformations, "each": each, "labels": labels}
    trial["seed"] = arguments.seed
    softness, skin = _softness(arguments), conditions.skin
    if arguments.untouched:
        found = untouched_trial(deformations, family, labels, request, conditions, arguments.seed, arguments.progress)
        return print_trial({"trial": {"kind": "untouched", **trial, "each": 1}, **found}, arguments.json)
    if arguments.single is not None:
        trial = {"kind": "single", "size_mm": arguments.single, **asdict(softness), **trial}
        phantoms = trials.single(arguments.single, deformations, each, family, softness, skin, arguments.seed)
    elif arguments.pair is not None:
        trial = {"kind": "pair", "gap_mm": arguments.pair, **trial}
        phantoms = trials.pair(arguments.pair, deformations, each, family, skin, arguments.seed)
    else:
        counts = _counts(arguments.random)
        trial = {"kind": "random", "touches": list(counts), **trial}
        phantoms = trials.random(counts, deformations, each, family, labels, skin, arguments.seed)
    _tell_unknown(request, [(one.truth, one.scene.touch_kind) for one in phantoms])
    found = touched_trial(phantoms, each, request, conditions, arguments.progress)
    _tell_unlike(found)
    return print_trial({"trial": trial, **found}, arguments.json)


def _tell_unknown(request: Any, groups: Any) -> None:
    """Say on stderr which touches of what is tried, (labels, touches), the bundle of a network does not know."""
    from eitskin_proto.skin.touch_kind import knows
    from eitskin_tools.evaluation.solvers import bundle_for, is_deployed

    for labels, touches in sorted(set(groups)) if is_deployed(request) else ():
        bundle = bundle_for(request, labels, touches)
        if not knows(bundle.touch_kind, touches):
            known = f"{bundle.path} knows touches = {bundle.touch_kind}"
            hint = "; --single with --contrast 0.4 tries the others" if touches == "raise" else ""
            note(f"eitskin evaluate: {known}, and is tried on touches = {touches}{hint}")


def _tell_unlike(found: dict[str, Any]) -> None:
    """Say on stderr in which ways clouds were unlike those that the skin's networks learned."""
    if modes := found["unlike_training"]:
        note(
            f"eitskin evaluate: cloud:unlike_training, by its {' and '.join(modes)}: the network was not trained on "
            "such surfaces; check its maps by physics (--solver verified)"
        )


def _softness(arguments: argparse.Namespace) -> Any:
    from eitskin_sim.evaluation.trials import HARD_SQUARE

    asked = {"contrast": arguments.contrast, "border_mm": arguments.border, "disc": arguments.disc or None}
    return replace(HARD_SQUARE, **{name: value for name, value in asked.items() if value is not None})


def _counts(text: str) -> tuple[int, int]:
    low, _, high = text.partition("-")
    if not (low.isdecimal() and (high or low).isdecimal()):
        raise UsageError(f"--random {text!r}: expected a number of touches or a range, such as 2-4")
    return int(low), int(high or low)
