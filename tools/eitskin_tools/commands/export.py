"""``eitskin export``: a training run's best epoch as a bundle, with the parity of every tensor."""

import argparse
from pathlib import Path
from typing import Any

from eitskin_tools.console.terminal import answer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("run_folder", metavar="RUN", help="folder of 'eitskin train'")
    parser.add_argument("--out", required=True, metavar="FILE", help="the bundle; its name should end in .eitskin")
    parser.add_argument("--data", nargs="+", metavar="DIR", help="the data sets of the run, if they have moved")


def run(arguments: argparse.Namespace) -> int:
    """Export and report."""
    from eitskin_export import package
    from eitskin_tools.command_line import files, kinds
    from eitskin_tools.console.progress import Stages
    from eitskin_training.run_files import data_of, trained

    out = Path(arguments.out)
    files.writable(out, kinds.BUNDLE)
    found = trained(Path(arguments.run_folder))
    data = data_of(found, arguments.data)
    with Stages() as tell:
        result = package.export(found, data, out, tell=tell)
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
