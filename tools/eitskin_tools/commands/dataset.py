"""``eitskin dataset --set paper|units|free --out DIR``: writes a data set, or goes on with one that was interrupted."""

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eitskin_tools.command_line import files, options
from eitskin_tools.command_line.parser import Parser, whole
from eitskin_tools.console.progress import ProgressBar
from eitskin_tools.console.terminal import answer
from eitskin_tools.errors import UsageError

if TYPE_CHECKING:
    from eitskin_sim.dataset.cluster import Certificates


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
    group = parser.add_more("cluster")
    group.add_argument("--scheduler", metavar="ADDRESS", help="use a Dask scheduler, such as tls://HOST:8786")
    group.add_argument("--tls-ca", type=Path, metavar="FILE", help="certificate of the cluster's authority")
    group.add_argument("--tls-cert", type=Path, metavar="FILE", help="your certificate, signed by it")
    group.add_argument("--tls-key", type=Path, metavar="FILE", help="your private key")


def run(arguments: argparse.Namespace) -> int:
    """Make the data set and report it."""
    from eitskin_sim.dataset.cluster import Certificates
    from eitskin_sim.dataset.generate import generate
    from eitskin_sim.dataset.plan import make_plan

    certificates = Certificates(arguments.tls_ca, arguments.tls_cert, arguments.tls_key)
    _check_scheduler(arguments.scheduler, certificates)
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
        index = generate(
            plan,
            arguments.out,
            workers=arguments.workers,
            scheduler=arguments.scheduler,
            certificates=certificates,
            progress=progress.show,
        )
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


def _check_scheduler(scheduler: str | None, certificates: "Certificates") -> None:
    """Refuse what cannot be meant, and warn of a cluster that anybody may be."""
    from eitskin_sim.dataset.cluster import check_address, is_exposed

    options = ", ".join(f"--tls-{name}" for name in certificates.given)
    if scheduler is None:
        if options:
            raise UsageError(f"{options} need --scheduler tls://HOST:PORT")
        return
    try:
        check_address(scheduler)
    except ValueError as error:
        raise UsageError(str(error)) from error
    if options and not scheduler.startswith("tls://"):
        raise UsageError(f"{options}: expected --scheduler tls://HOST:PORT, found {scheduler}")
    if is_exposed(scheduler):
        print(
            f"eitskin dataset: warning: {scheduler} is not encrypted and authenticates nobody: anyone on the network "
            "can run code there and here; use tls:// with --tls-ca, --tls-cert and --tls-key",
            file=sys.stderr,
            flush=True,
        )


def _text(report: dict[str, Any]) -> str:
    bends = report["deformations"]
    return (
        f"{report['out']}: {report['samples']} samples of {report['touch_sets']} touch sets at {bends['train']} "
        f"deformations, {bends['kept']} + {bends['other']} held out; {report['bytes'] / 1e6:.1f} MB, "
        f"{report['seconds']:.1f} s, digest {report['digest']}"
    )
