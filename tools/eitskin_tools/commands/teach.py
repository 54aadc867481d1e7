"""``eitskin teach FILE.npz --out B.eitskin``: a bundle that finds touches as recorded presses have shown them."""

import argparse
import json
import os
import sys
from pathlib import Path

from eitskin_tools.command_line import files, kinds, options
from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("presses", type=Path, metavar="FILE", help="recorded presses at known places (.npz)")
    parser.add_argument("--out", type=Path, required=True, metavar="B.eitskin", help="the bundle to write")
    parser.add_argument("--skin", metavar="SKIN.toml", help="description of the sheet (default: its size alone)")
    parser.add_argument(
        "--false-alarms", type=float, default=0.01, metavar="SHARE",
        help="share of untouched frames that may look touched (default: 0.01)",
    )  # fmt: skip
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="draw where presses are placed well and badly")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Teach, write the bundle and report."""
    if not 1e-4 <= arguments.false_alarms <= 0.5:
        raise UsageError(f"--false-alarms is {arguments.false_alarms:g}, expected 0.0001 to 0.5")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is first imported, below
    files.writable(arguments.out, kinds.BUNDLE)
    if arguments.picture is not None:
        files.picture(arguments.picture)
    from eitskin_tools.console.terminal import StatusLine
    from eitskin_tools.teach import card
    from eitskin_tools.teach.presses import load_presses
    from eitskin_tools.teach.taught_bundle import write_taught
    from eitskin_tools.teach.teaching import teach

    presses = load_presses(files.find(arguments.presses, files.PRESSES))
    skin = None if arguments.skin is None else options.read_skin(arguments.skin)
    line = StatusLine(sys.stderr)
    taught = teach(presses, skin, arguments.false_alarms, line.show)
    line.end()
    bundle = write_taught(arguments.out, taught, presses, tikhonov=skin is not None)
    if arguments.picture is not None:
        card.draw(arguments.picture, taught)
    if arguments.json:
        print(json.dumps({"out": str(arguments.out), "bundle": bundle, **taught.report}))
        return 0
    print(card.verdict(taught.report))
    after = "Wrote {}. Next: eitskin run --bundle {}"
    if not presses.logarithmic:
        after = "Wrote {}. Its changes have no known unit, so it works with 'eitskin evaluate --measured' alone ({})."
    print(after.format(arguments.out, arguments.out))
    return 0
