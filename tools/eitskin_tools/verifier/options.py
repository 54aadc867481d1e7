"""``--verify`` of ``eitskin run`` and ``eitskin replay``: its options, and the verifier that they start."""

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from eitskin.pipeline.latency_budget import MOST_MS
from eitskin_tools.command_line import needs
from eitskin_tools.command_line.parser import CPUS, positive, whole
from eitskin_tools.errors import UsageError

if TYPE_CHECKING:
    from eitskin.frame_record import FrameRecord

CLOUDS: Final = ("scan", "fitted", "flat")

MODES: Final = ("off", "idle", "always")

NICE: Final = 10
"""Default nice value, so that a runtime on the same core comes first."""


def add_arguments(parser: Any) -> None:
    """Declare the options of a parser or of a group."""
    parser.add_argument(
        "--verify",
        choices=MODES,
        metavar="MODE",
        default="off",
        help="check frames against the forward model: off, always (each change) or idle (at rest, on an idle core)",
    )
    parser.add_argument(
        "--verify-budget-ms", type=positive(MOST_MS), metavar="B", help="time limit for a frame in ms (default 500)"
    )
    parser.add_argument(
        "--cloud",
        choices=CLOUDS,
        help="shape that --verify assumes: as scanned, else as frames show (default); fitted to frames; or flat",
    )
    parser.add_argument(
        "--verify-nice",
        type=whole(0, 19),
        metavar="N",
        help=f"priority of the verifier, 0 to 19 (default {NICE})",
    )
    parser.add_argument(
        "--verify-affinity",
        type=CPUS,
        metavar="CPUS",
        help="CPUs of the verifier (default: what --affinity leaves)",
    )


def check(arguments: argparse.Namespace) -> None:
    """Refuse what cannot be, before anything is opened, and note as ``verify_cpus`` where the verifier runs.

    Raises:
        UsageError: An option makes no sense.
        MissingExtraError: The forward model needs what is not installed.
    """
    arguments.verify_cpus = ()
    given = [name for name in ("budget_ms", "nice", "affinity") if getattr(arguments, f"verify_{name}") is not None]
    if arguments.verify == "off":
        if arguments.cloud is not None:
            raise UsageError("--cloud needs --verify idle or --verify always")
        if given:
            raise UsageError(f"--verify-{given[0].replace('_', '-')} needs --verify idle or --verify always")
        return
    arguments.verify_cpus = cpus(arguments, os.sched_getaffinity(0))  # before the runtime takes its own
    needs.require(f"--verify {arguments.verify}", ("scipy",))


def cpus(arguments: argparse.Namespace, available: set[int]) -> tuple[int, ...]:
    """Return the CPUs of the verifier: those asked for, or those that the runtime leaves.

    Args:
        arguments: Of the command line.
        available: Before the runtime took its own.

    Raises:
        UsageError: One does not exist, or is not ours.
    """
    if arguments.verify_affinity is None:
        return tuple(sorted(available - set(getattr(arguments, "affinity", None) or ()) or available))
    found = set(arguments.verify_affinity)
    if missing := sorted(found - available):
        raise UsageError(f"--verify-affinity: CPU {missing}: expected some of {sorted(available)}")
    return tuple(sorted(found))


@contextmanager
def verifying(
    skin: Any, publisher: Any, arguments: argparse.Namespace, *, is_replay: bool = False
) -> "Iterator[Callable[[FrameRecord], None] | None]":
    """Run a verifier while a skin is served, and give what to call after each frame; None with ``--verify off``.

    Args:
        skin: Open.
        publisher: Bound.
        arguments: Of the command line, checked.
        is_replay: Whether its clouds are those of a recording alone.

    Raises:
        UsageError: The skin is a disc.
    """
    if arguments.verify == "off":
        yield None
        return
    if skin.pipeline.skin.outline.kind == "disc":
        raise UsageError("--verify needs a rectangle: no touches are modelled on a disc; leave it out")
    from eitskin_sim.scene.family import NO_FAMILY, is_family
    from eitskin_tools.verifier.child import Placement, VerifierProcess
    from eitskin_tools.verifier.feed import VerifierFeed
    from eitskin_tools.verifier.letters import BUDGET_S

    cloud = arguments.cloud or "scan"
    if cloud == "fitted" and not is_family(skin.pipeline.skin.deformations):
        raise UsageError(f"--cloud fitted: {NO_FAMILY}")
    nice = NICE if arguments.verify_nice is None else arguments.verify_nice
    place = Placement(nice, arguments.verify_cpus, idle=arguments.verify == "idle")
    with VerifierProcess(place) as process:
        budget_s = BUDGET_S if arguments.verify_budget_ms is None else arguments.verify_budget_ms * 1e-3
        feed = VerifierFeed(skin, publisher, process, arguments.verify, budget_s, cloud, gives_shapes=not is_replay)
        skin.loop.verifier_status = feed.status
        yield feed.after_frame
