"""``eitskin build SKIN.toml --out FILE.eitskin``: data, training, export and card of a bundle, in one command.

It may be stopped at any time, by Ctrl-C or by force; the same command resumes. With ``--physics`` it takes a minute and
trains nothing.
"""

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eitskin_proto.files.writing import held
from eitskin_tools.command_line import files, kinds, options
from eitskin_tools.command_line.parser import positive, whole
from eitskin_tools.console.terminal import answer, note

if TYPE_CHECKING:
    from eitskin_tools.build.recipe import BuildRecipe

MANY_DEFORMATIONS: Final = 3000
"""Deformations that a core draws and checks in a minute, before any is simulated."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    shipped = ", ".join(dict.fromkeys((*files.RECIPE.names(), *files.SKIN.names())))
    parser.add_argument(
        "recipe", metavar="SKIN.toml", help=f"a skin's description, or a recipe: a file, or one of {shipped}"
    )
    parser.add_argument(
        "--hours",
        type=positive(1e4),
        metavar="H",
        help="scale data and epochs to H hours on this machine (default: full length)",
    )
    parser.add_argument(
        "--physics", action="store_true", help="train no network: solvers and gate from the forward model, in a minute"
    )
    add_making(parser)


def add_making(parser: argparse.ArgumentParser) -> None:
    """Declare the options of every command that builds a bundle."""
    parser.add_argument(
        "--out", required=True, type=Path, metavar="FILE", help="the bundle; its name should end in .eitskin"
    )
    parser.add_argument(
        "--work", type=Path, metavar="DIR", help="folder for intermediate results (default: FILE.eitskin.build)"
    )
    parser.add_argument(
        "--workers", type=whole(1), metavar="N", help="processes that make data (default: one per core)"
    )
    parser.add_argument("--threads", type=whole(0), default=0, help="CPU threads of training (default: torch's choice)")


def run(arguments: argparse.Namespace) -> int:
    """Build, and report."""
    from eitskin_tools.build import recipe

    if arguments.physics:
        return _build_physics(arguments)
    return make(recipe.load(arguments.recipe), arguments, arguments.hours)


def make(
    asked: "BuildRecipe",
    arguments: argparse.Namespace,
    hours_asked: float | None = None,
    gentle_of: Path | None = None,
) -> int:
    """Build the bundle of a recipe, or resume it, and report.

    Args:
        asked: What is asked for.
        arguments: Those of :func:`add_making`.
        hours_asked: To scale it to; None leaves it as it is.
        gentle_of: A bundle whose network for gentle touches goes in as it is; None for none.
    """
    from eitskin_tools.build import folder as half_made
    from eitskin_tools.build import steps
    from eitskin_tools.build.making import TRAINING_SHARES, Making, plan_lines
    from eitskin_tools.command_line import files, kinds
    from eitskin_tools.console.progress import Stages
    from eitskin_tools.evaluation import card

    files.writable(arguments.out, kinds.BUNDLE)
    work = arguments.work or arguments.out.with_name(f"{arguments.out.name}.build")
    others, workers = asked.others(), steps.processes(arguments.workers)
    half_made.begun(work, asked, hours_asked)
    for line in plan_lines(asked, others, workers, hours_asked):
        note(line)
    if (many := sum(one.deformations for one in asked.data.values())) > MANY_DEFORMATIONS:
        note(f"drawing {many:,} deformations first, about {many // MANY_DEFORMATIONS} min")
    for one in (asked, *others.values()):
        steps.check(one)
    if arguments.threads:
        import torch

        torch.set_num_threads(arguments.threads)
    began = time.monotonic()
    work.mkdir(parents=True, exist_ok=True)
    hint = "wait until it ends, or name another folder with --work"
    with held(work, "another process is building a bundle there", hint), Stages() as tell:
        making = Making(workers, tell, note)
        own = 1.0 - sum(TRAINING_SHARES[name] for name in others)
        parts = [(other, work / name, TRAINING_SHARES[name]) for name, other in others.items()]
        making.begin([(asked, work, own), *parts], hours_asked)
        made = making.made(asked, work, hours_asked, share=own)
        made = making.with_others(made, others, work, hours_asked, gentle_of)
        found, identity = making.finished(made, work, arguments.out)
    wanted, exported = made.recipe, made.exported
    result: dict[str, Any] = {
        "bundle": identity,
        "path": str(arguments.out),
        "bytes": arguments.out.stat().st_size,
        "recipe": {"name": wanted.name, "digest": wanted.digest},
        "labels": exported["labels"],
        "touches": exported["touches"],
        "seconds": round(time.monotonic() - began, 1),
        "gate": exported["gate"],
        "card": found,
    }
    return answer(
        arguments,
        result,
        f"Done: {arguments.out}. {card.summary(found)}",
        f"bundle {identity}, {result['bytes'] / 1e6:.1f} MB, {result['labels']} labels, {result['touches']} touches, "
        f"{result['seconds'] / 60:.0f} min",
        *card.lines_of(found),
        f"You may remove {work}.",
    )


def _build_physics(arguments: argparse.Namespace) -> int:
    """Build without training, and report."""
    from eitskin_tools.build import physics, steps
    from eitskin_tools.console.progress import Stages
    from eitskin_tools.errors import UsageError
    from eitskin_tools.evaluation import physics_card

    given = [name for name in ("hours", "work", "threads") if getattr(arguments, name)]
    if given:
        raise UsageError(f"--{given[0]} does nothing with --physics: leave it out")
    files.writable(arguments.out, kinds.BUNDLE)
    skin = options.read_skin(arguments.recipe)
    with Stages() as tell:
        found = physics.build(skin, arguments.out, steps.processes(arguments.workers), tell, note)
    size_mb, touches = found["bytes"] / 1e6, found["touches"]
    return answer(
        arguments,
        found,
        f"Done: {arguments.out}. {physics_card.summary(found['card'])}",
        f"bundle {found['bundle']}, {size_mb:.1f} MB, {touches} touches, no network, {found['seconds']:.0f} s",
        *physics_card.lines_of(found["card"]),
    )
