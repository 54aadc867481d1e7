"""What each part of the network is worth, and how many deformations it needs.

Short trainings of equal length that differ in one thing (:mod:`eitskin_training.ablations`). The figures rank inputs;
they are not those of the shipped bundles, which train for longer.
"""

import argparse
import json
import sys
from dataclasses import replace
from typing import Any

from eitskin_tools.bench.harness import program
from eitskin_tools.errors import UsageError

DEFORMATIONS = (10, 30, 120)
"""How many deformations the inputs are compared with, besides all."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--data", required=True, metavar="DIR", help="a data set of 'eitskin dataset'")
    parser.add_argument("--recipe", default="free", help="recipe that every variant changes (default free)")
    parser.add_argument("--epochs", type=int, default=4, help="of each training (default 4)")
    parser.add_argument("--samples", type=int, default=100_000, help="of an epoch (default 100000)")
    parser.add_argument(
        "--variants",
        metavar="NAMES",
        help="what is changed, comma-separated; a name that does not exist lists them (default: all)",
    )
    parser.add_argument("--seed", type=int, default=0, help="of weights, order and noise (default 0)")
    parser.add_argument("--threads", type=int, default=1, help="CPU threads (default 1)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Train, score and report."""
    import numpy as np
    import torch

    from eitskin_training.ablations import VARIANTS, ablate, variant_recipe
    from eitskin_training.recipes import recipe
    from eitskin_training.samples.loaded import load

    for name in ("epochs", "samples", "threads"):
        if getattr(arguments, name) < 1:
            raise UsageError(f"--{name} is {getattr(arguments, name)}; expected at least 1")
    torch.set_num_threads(arguments.threads)
    names = arguments.variants.split(",") if arguments.variants else list(VARIANTS)
    if unknown := set(names) - set(VARIANTS):
        raise UsageError(f"variants {', '.join(sorted(unknown))} are unknown; expected some of {', '.join(VARIANTS)}")
    try:
        base = replace(recipe(arguments.recipe), epochs=arguments.epochs)
        if not arguments.variants and not base.architecture.symmetric:
            names.remove("unmirrored")
        for name in names:
            variant_recipe(base, name)
    except ValueError as error:
        raise UsageError(str(error)) from error
    data = load(arguments.data)
    pairs: list[tuple[str, int | None]] = [(name, None) for name in names]
    available = len(np.unique(data.deformation[data.train]))
    counts = [count for count in DEFORMATIONS if count < available]
    pairs += [(name, count) for count in counts for name in names if name in ("none", "cloud", "predicted")]
    rows: list[dict[str, Any]] = []
    for result in ablate(
        data,
        base,
        pairs,
        samples=arguments.samples,
        seed=arguments.seed,
        tell=lambda text: print(text, file=sys.stderr),
    ):
        rows.append(result.to_json())
        if not arguments.json:
            print("  ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
    if arguments.json:
        print(json.dumps({"data": data.digest, "recipe": base.name, "epochs": base.epochs, "rows": rows}))
    return 0


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
