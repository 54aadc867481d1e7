"""``eitskin dataset --set paper|units|free --out DIR``: writes a data set, or goes on with one that was interrupted."""

import argparse
import time
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files, options
from eitskin_tools.command_line.parser import Parser, whole
from eitskin_tools.console.progress import ProgressBar
from eitskin_tools.console.terminal import answer


def add_arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--set",
        dest="set_name",
        choices=("paper", "units", "free"),
        required=True,
        help="the paper's 102,590 samples; richer shapes of units; touches anywhere",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to write; an interrupted data set continues"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all draws (default 0)")
    parser.add_argument(
        "--deformations", "--bends", type=int, metavar="N", help="deformations to train on (default 10, 140, 140)"
    )
    parser.add_argument("--kept", type=int, metavar="N", help="deformations held out of A and of B (default 0, 20, 20)")
    parser.add_argument(
        "--touch-sets", type=int, metavar="N", help="touch sets in all (default 10259, 60000); free has one a sample"
    )
    parser.add_argument(
        "--per-deformation", type=int, metavar="N", help="touch sets at each deformation (default all, 3000, 5000)"
    )
    parser.add_argument(
        "--near", type=float, metavar="SHARE", help="share of free touch sets drawn close together (default 1/3)"
    )
    parser.add_argument(
        "--touches",
        choices=("hard", "firm", "press", "raise", "both", "skin"),
        default="hard",
        help="contrast: hard 20 to 200 (50 on the grid), firm 5 to 200 with soft edges, press 0.2 to 0.85, raise "
        "1.2 to 200, both, or skin for [touches] of --skin (default hard)",
    )
    parser.add_argument(
        "--devices",
        choices=("ideal", "random", "offset"),
        default="ideal",
        help="ideal, the nominal sheet; random, with a lab's errors; offset, read with a large offset too (default "
        "ideal)",
    )
    parser.add_argument(
        "--skin",
        metavar="FILE",
        help=f"skin.toml of the sheet and its uncertainties: a file, or one of {', '.join(files.SKIN.names())} "
        "(default: the paper's, for random devices lab)",
    )
    parser.add_argument(
        "--workers", type=whole(1), default=1, metavar="N", help="processes on this machine (default 1)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Make the data set and report it."""
    from eitskin_sim.dataset.generate import generate
    from eitskin_sim.dataset.plan import make_plan

    files.folder(arguments.out)
    plan = make_plan(
        arguments.set_name,
        arguments.seed,
        deformations=arguments.deformations,
        touch_sets=arguments.touch_sets,
        per_deformation=arguments.per_deformation,
        kept=arguments.kept,
        near=arguments.near,
        touches=arguments.touches,
        devices=arguments.devices,
        skin=None if arguments.skin is None else options.read_skin(arguments.skin),
    )
    start = time.perf_counter()
    with ProgressBar(arguments.set_name, "samples") as progress:
        index = generate(plan, arguments.out, workers=arguments.workers, progress=progress.show)
    seconds = time.perf_counter() - start
    report = {
        "out": str(arguments.out),
        "set": plan.set_name,
        "touches": plan.touches,
        "devices": plan.devices,
        "skin_digest": plan.skin.digest,
        "samples": index["samples"],
        "made": progress.made,
        "deformations": {split: plan.splits.count(split) for split in ("train", "kept", "other")},
        "touch_sets": plan.touch_sets,
        "bytes": sum(file.stat().st_size for file in arguments.out.iterdir()),
        "seconds": round(seconds, 2),
        "samples_per_s": round(progress.made / seconds, 1),
        "seed": plan.seed,
        "digest": index["digest"],
    }
    return answer(arguments, report, _text(report))


def _text(report: dict[str, Any]) -> str:
    bends = report["deformations"]
    return (
        f"{report['out']}: {report['samples']} samples of {report['touch_sets']} touch sets at {bends['train']} "
        f"deformations, {bends['kept']} + {bends['other']} held out; {report['bytes'] / 1e6:.1f} MB, "
        f"{report['seconds']:.1f} s, digest {report['digest']}"
    )
