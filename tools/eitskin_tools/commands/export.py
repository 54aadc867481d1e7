"""``eitskin export``: a training run's best epoch as a bundle, with the parity of every tensor."""

import argparse
from pathlib import Path
from typing import Any

from eitskin_tools.command_line.parser import whole
from eitskin_tools.console.terminal import answer, note


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("run_folder", metavar="RUN", help="folder of 'eitskin train'")
    parser.add_argument("--out", required=True, metavar="FILE", help="the bundle; its name should end in .eitskin")
    parser.add_argument("--data", nargs="+", metavar="DIR", help="the data sets of the run, if they have moved")
    parser.add_argument(
        "--phantoms",
        action="append",
        default=[],
        metavar="FILE",
        help="also score these and write the result to the card",
    )
    parser.add_argument("--seeds", type=whole(1), default=3, help="noise draws for each phantom (default 3)")


def run(arguments: argparse.Namespace) -> int:
    """Export and report."""
    from eitskin_export import package
    from eitskin_export.bundle import amend
    from eitskin_tools.command_line import files, kinds
    from eitskin_tools.console.progress import Stages
    from eitskin_training.run_files import data_of, trained

    out = Path(arguments.out)
    files.writable(out, kinds.BUNDLE)
    for path in arguments.phantoms:
        files.find(path, files.PHANTOMS)
    found = trained(Path(arguments.run_folder))
    data = data_of(found, arguments.data)
    with Stages() as tell:
        result = package.export(found, data, out, tell=tell)
    if arguments.phantoms:
        result["phantoms"] = _phantoms(arguments.phantoms, arguments.seeds, str(result["labels"]), out)
        result["bundle"] = amend(out, {"phantoms": result["phantoms"]})
        result["bytes"] = out.stat().st_size
    int8 = result["int8"]
    lines = [
        f"{result['path']}: bundle {result['bundle']}, {result['bytes'] / 1e6:.1f} MB, {result['labels']} labels",
        *(f"parity, {tensor}: largest difference {found:.1e}" for tensor, found in result["parity"].items()),
        f"int8 against float32: rms {int8['rms']:.1e}, {100 * int8['flipped']:.3f} % of pixels flip",
        _gate_line(result["gate"]),
    ]
    for family, noises in result["held_out"].items():
        scores = ", ".join(f"{noise} CC {entry['cc']:.4f}" for noise, entry in noises.items())
        lines.append(f"unseen bends of family {family}: {scores}")
    for name, noises in result.get("phantoms", {}).items():
        scores = ", ".join(f"{noise} CC {entry['mean']['cc']:.4f}" for noise, entry in noises["vd2t"].items())
        lines.append(f"phantoms of {name}: {scores}")
    return answer(arguments, result, *lines)


def _gate_line(gate: dict[str, Any]) -> str:
    """Return what a gate is worth, in a line, and in one for each of the presses that it was tried on."""
    low, high = (100 * value for value in gate["false_alarm_interval_95"])
    found = (
        f"gate: {100 * gate['false_alarm_rate']:.2f} % false alarms ({low:.2f} to {high:.2f} %) on "
        f"{gate['held_out_bends']} bends never seen, {100 * gate['missed_rate']:.2f} % of touches missed"
    )
    for name, families in gate.get("found_presses", {}).items():
        shares = ", ".join(f"{100 * frames['5']:.0f} % ({family})" for family, frames in families.items())
        found += f"\ngate: {name}, found within 5 frames: {shares}"
    return found


def _phantoms(paths: list[str], seeds: int, labels: str, bundle: Path) -> dict[str, Any]:
    """Return {file: {solver: {noise: report}}} of a bundle's heads on the phantoms whose truth has its labels."""
    from eitskin.model.bundle import load_bundle
    from eitskin.model.engine import solvers
    from eitskin_sim.evaluation.harness import Conditions
    from eitskin_sim.measurement.noise import KINDS
    from eitskin_sim.scene.scene import load_phantoms
    from eitskin_tools.command_line import files
    from eitskin_tools.evaluation.solvers import NETWORKS, Request, evaluate_requests

    heads = [name for name in solvers(load_bundle(bundle, lazily=True)) if name in NETWORKS]
    found: dict[str, Any] = {}
    for path in paths:
        phantoms = [one for one in load_phantoms(files.find(path, files.PHANTOMS)) if one.truth == labels]
        if not phantoms:
            note(f"{path} holds no phantoms with {labels} labels; left out")
            continue
        note(f"scoring {len(phantoms)} phantoms of {path}")
        requests = [Request(name, bundle=bundle) for name in heads]
        by_noise = {
            noise: evaluate_requests(phantoms, requests, Conditions(noise=noise, snr_db=50.0, seeds=seeds))  # type: ignore[arg-type]
            for noise in KINDS
            if noise != "none"
        }
        found[Path(path).name] = {
            name: {noise: reports[number] for noise, reports in by_noise.items()} for number, name in enumerate(heads)
        }
    return found
