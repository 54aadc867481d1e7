"""``eitskin evaluate``: score a solver on phantoms, or all of them beside the paper's Table II."""

import argparse
import json

from eitskin_tools.cli import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommand's arguments."""
    parser.add_argument("--phantoms", required=True, metavar="FILE", help="JSON list of phantoms")
    parser.add_argument(
        "--solver",
        default="vd2t",
        help="vd2t, vd2t-int8, tikhonov, l1 or sbl; the last three take the grid of the phantoms' labels, or the one "
        "that -pixels or -units names (default: vd2t)",
    )
    parser.add_argument("--all", action="store_true", help="print a Markdown table of all solvers beside the paper's")
    parser.add_argument("--noise", default="N2", choices=("N1", "N2", "N3", "none"), help="default: N2")
    parser.add_argument("--snr-db", type=float, default=50.0, metavar="S", help="default: 50")
    parser.add_argument(
        "--reference",
        choices=("pre", "post", "predicted"),
        help="what the voltages are compared with (default: pre for vd2t, post for the others)",
    )
    parser.add_argument("--seeds", type=int, default=1, metavar="K", help="noise draws for each phantom (default: 1)")
    parser.add_argument("--bundle", metavar="FILE", help="the network; default: the shipped one with the same labels")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate, and print an object or a table."""
    from eitskin_sim.scene import load_phantoms
    from eitskin_tools.evaluation import NAMES, PAPER_CC, comparison, evaluate_named

    if arguments.seeds < 1:
        raise UsageError(f"--seeds {arguments.seeds}: expected at least 1")
    if arguments.solver not in NAMES:
        raise UsageError(f"--solver {arguments.solver!r}: expected one of {', '.join(NAMES)}")
    phantoms = load_phantoms(arguments.phantoms)
    if not phantoms:
        raise ValueError(f"{arguments.phantoms} holds no phantom; expected a list of at least one")
    if arguments.all:
        table = comparison(phantoms, noise=arguments.noise, snr_db=arguments.snr_db, seeds=arguments.seeds)
        print(json.dumps({"table": table}) if arguments.json else table)
        return 0
    found = evaluate_named(
        phantoms,
        arguments.solver,
        noise=arguments.noise,
        snr_db=arguments.snr_db,
        reference=arguments.reference,
        seeds=arguments.seeds,
        bundle=arguments.bundle,
    )
    if arguments.json:
        print(json.dumps(found))
        return 0
    paper = PAPER_CC.get(arguments.solver.split("-")[0]) if len(phantoms) == len(PAPER_CC["l1"]) else None
    print(f"{found['solver']}, {found['noise']} at {found['snr_db']:g} dB, reference: {found['reference']}")
    print("phantom      CC   PSNR dB    RIE   localisation mm   exact" + ("   paper's CC" if paper else ""))
    rows = [*found["phantoms"], {"name": "mean", **found["mean"]}]
    papers = [*paper, sum(paper) / len(paper)] if paper else [None] * len(rows)
    for row, theirs in zip(rows, papers, strict=True):
        rie = "    inf" if row["rie"] is None else f"{row['rie']:7.4f}"
        line = f"{row['name']:8} {row['cc']:8.4f} {row['psnr_db']:8.2f} {rie}"
        line += f" {row['localisation_mm']:16.2f} {row['exact']:8.2f}"
        print(line if theirs is None else f"{line} {theirs:12.4f}")
    return 0
