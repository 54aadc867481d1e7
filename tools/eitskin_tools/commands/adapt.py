"""``eitskin adapt``: train a network further for missing electrodes; takes minutes."""

import argparse
from pathlib import Path

from eitskin_tools.command_line import files
from eitskin_tools.command_line.options import SEED
from eitskin_tools.command_line.parser import whole
from eitskin_tools.console.terminal import answer, note


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("run_folder", metavar="RUN", help="folder of 'eitskin train'")
    parser.add_argument("--out", required=True, metavar="RUN2", help="folder of the adapted run, for 'eitskin export'")
    parser.add_argument("--data", nargs="+", metavar="DIR", help="the data sets of the run, if they have moved")
    parser.add_argument(
        "--fitting-steps", type=int, default=2000, metavar="N", help="training steps of the imputation alone"
    )
    parser.add_argument(
        "--steps", type=int, default=3000, metavar="N", help="training steps of imputation and network together"
    )
    parser.add_argument("--seed", type=SEED, default=0, help="seed of every draw (default 0)")
    parser.add_argument("--threads", type=whole(0), default=0, help="CPU threads (default: torch's choice)")


def run(arguments: argparse.Namespace) -> int:
    """Adapt and report."""
    import torch

    from eitskin_tools.errors import UsageError
    from eitskin_training import adapt
    from eitskin_training.gate import stored
    from eitskin_training.run_files import data_of, trained

    try:
        plan = adapt.Plan(fitting_steps=arguments.fitting_steps, steps=arguments.steps)
    except ValueError as error:
        raise UsageError(str(error)) from error
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    source, out = Path(arguments.run_folder), files.folder(arguments.out)
    if (out / "best.pt").exists():
        raise UsageError(f"{out} already holds a run; name another folder with --out, or remove it")
    found = trained(source)
    data = data_of(found, arguments.data)
    adapted = adapt.adapt(found.model, found.recipe, data, plan, seed=arguments.seed, tell=note)
    sources = [str(Path(one).resolve()) for one in arguments.data or ()]
    content = {**found.content, "data": sources or found.content["data"]}
    path = adapt.write(out, content, adapted)
    stored.hand_on(source, out)
    before, after = adapted.facts["before"], adapted.facts["after"]
    return answer(
        arguments,
        {"run": str(out), **adapted.facts},
        f"{path}: mean CC on bends never seen, with N2 noise",
        *(
            f"{name:10s}  {before[name]:.4f} -> {one:.4f}, {one / after['whole']:.4f} of whole"
            for name, one in after.items()
        ),
        f"next: eitskin export {out} --out {out}.eitskin",
    )
