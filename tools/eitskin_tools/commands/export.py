"""``eitskin export``: a training run's best epoch as a bundle, with the parity of every tensor."""

import argparse
import json
import sys
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("run_folder", metavar="RUN", help="folder of 'eitskin train'")
    parser.add_argument("--out", required=True, metavar="FILE", help="the bundle, by custom FILE.eitskin")
    parser.add_argument("--data", metavar="DIR", help="the run's data set, if it has moved")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Export and report."""
    from eitskin_export import package

    found = package.trained(Path(arguments.run_folder))
    data = package.data_of(found, arguments.data)
    result = package.export(
        found, data, Path(arguments.out), tell=lambda text: print(text, file=sys.stderr, flush=True)
    )
    if arguments.json:
        print(json.dumps(result))
        return 0
    print(f"{result['path']}: bundle {result['bundle']}, {result['bytes'] / 1e6:.1f} MB, {result['labels']} labels")
    for tensor, difference in result["parity"].items():
        print(f"parity, {tensor}: largest difference {difference:.1e}")
    print(
        f"int8 against float32: rms {result['int8']['rms']:.1e}, {100 * result['int8']['flipped']:.3f} % of pixels flip"
    )
    gate = result["gate"]
    print(f"gate: {100 * gate['false_alarm_rate']:.2f} % false alarms, {100 * gate['missed_rate']:.2f} % missed")
    for family, noises in result["held_out"].items():
        scores = ", ".join(f"{noise} CC {entry['cc']:.4f}" for noise, entry in noises.items())
        print(f"unseen bends of family {family}: {scores}")
    return 0
