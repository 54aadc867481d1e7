"""``eitskin train``: train VD2T and its gate on a data set, with a bar on a terminal and a line per epoch elsewhere."""

import argparse
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files
from eitskin_tools.command_line.options import SEED
from eitskin_tools.command_line.parser import whole
from eitskin_tools.console.progress import ProgressBar
from eitskin_tools.console.terminal import answer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument(
        "--recipe", required=True, metavar="NAME", help="paper, units, free, small, small-units or tiny"
    )
    parser.add_argument(
        "--data", required=True, nargs="+", metavar="DIR", help="data sets of 'eitskin dataset'; several count as one"
    )
    parser.add_argument("--out", required=True, metavar="RUN", help="folder to write the run to")
    parser.add_argument("--epochs", type=int, help="epochs (default: the recipe's)")
    parser.add_argument("--learning-rate", type=float, help="instead of the recipe's")
    parser.add_argument("--schedule", choices=["constant", "onecycle"], help="instead of the recipe's")
    parser.add_argument("--seed", type=SEED, default=0, help="seed of weights, order, noise and dropout (default 0)")
    parser.add_argument("--resume", action="store_true", help="continue after the run's last complete epoch")
    parser.add_argument("--threads", type=whole(0), default=0, help="CPU threads (default: torch's choice)")


def run(arguments: argparse.Namespace) -> int:
    """Train and report."""
    import torch

    from eitskin_tools.console.progress import Stages
    from eitskin_tools.errors import UsageError
    from eitskin_training import train
    from eitskin_training.gate import stored
    from eitskin_training.recipes import fitted, recipe
    from eitskin_training.samples.joined import load_all

    changes = {
        name: value
        for name in ("epochs", "learning_rate", "schedule")
        if (value := getattr(arguments, name)) is not None
    }
    try:
        chosen = replace(recipe(arguments.recipe), **changes)
    except ValueError as error:
        raise UsageError(str(error)) from error
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    out = files.folder(arguments.out)
    for folder in arguments.data:
        files.find(folder, files.DATA_SET)
    data = load_all(arguments.data)
    chosen = fitted(chosen, data.skin)
    with ProgressBar("training", lines=False) as bar:
        done = train.train(
            data,
            chosen,
            out,
            seed=arguments.seed,
            resume=arguments.resume,
            sources=tuple(str(Path(folder).resolve()) for folder in arguments.data),
            progress=partial(_shown, bar),
        )
    with Stages() as tell:
        own = stored.gate_of_run(out, data, arguments.seed, tell=tell)
    best = done.best
    assert best is not None
    result: dict[str, Any] = {
        "run": str(out),
        "recipe": chosen.name,
        "epochs": len(done.history),
        "best": asdict(best),
        "seconds": round(sum(epoch.seconds for epoch in done.history), 1),
        "parameters": done.model.parameter_count(),
        "streamed_weights": done.model.streamed_weights(),
        "device": str(train.device()),
        "gate": own.gate.facts(),
    }
    return answer(
        arguments,
        result,
        f"best epoch {best.number}: validation loss {best.validation_loss:.5f}, CC {best.validation_cc:.4f}",
        f"next: eitskin export {out} --out {out}.eitskin",
    )


def _shown(bar: ProgressBar, now: Any) -> None:
    """Show a step of training, and an epoch that has ended in a line."""
    bar.show(now.step, now.steps)
    if (epoch := now.finished) is not None:
        left_min = (now.epochs - epoch.number) * epoch.seconds / 60
        bar.report(
            f"epoch {epoch.number}/{now.epochs} loss {epoch.training_loss:.5f} "
            f"validation {epoch.validation_loss:.5f} CC {epoch.validation_cc:.4f} {epoch.seconds:.1f} s, "
            f"{left_min:.0f} min left"
        )
