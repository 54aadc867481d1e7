"""``eitskin subscribe``: print what a runtime publishes, or count it.

In mode ``latest`` one line is kept up to date on a terminal, and written every second elsewhere; mode ``all`` prints a
line a frame.
"""

import argparse
import contextlib
import json
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eitskin_tools.command_line import options
from eitskin_tools.command_line.parser import positive, whole
from eitskin_tools.console.terminal import say
from eitskin_tools.errors import UsageError

if TYPE_CHECKING:
    from eitskin_proto.skin.skin import Skin

REPEAT_S = 0.1
"""Between two lists of touches in mode ``latest``; events of touches are always printed."""

STATE_S = 3.0
"""Longest wait, behind the first frame, for what the runtime says of its skin every second."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("endpoint", nargs="?", help="where the runtime publishes (default: its default)")
    parser.add_argument(
        "--mode", choices=("latest", "all"), default="latest", help="the newest frame (default), or every frame"
    )
    parser.add_argument("--frames", type=whole(1), metavar="N", help="end after N frames")
    parser.add_argument("--seconds", type=positive(), metavar="S", help="end after S seconds")
    parser.add_argument("--timeout-s", type=positive(), default=5.0, metavar="T", help="fail after T s without a frame")
    options.add_skin(parser, "the sheet's size, so that places are in mm")
    parser.add_argument("--touches", action="store_true", help="print touches instead of maps")
    parser.add_argument("--verified", action="store_true", help="print the verifier's results instead of frames")
    parser.add_argument(
        "--force-table", type=Path, metavar="FILE.csv", help="with --verified: your table from strength to newtons"
    )
    options.add_client_keys(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print what comes (or, with ``--json``, one object at the end) and return 0."""
    if arguments.verified and arguments.touches:
        raise UsageError("--verified receives no frames: leave out --touches")
    if arguments.force_table is not None and not arguments.verified:
        raise UsageError("--force-table needs --verified: only the verifier estimates a touch's strength")
    from eitskin.messaging.streams.subscription import subscribe_streams
    from eitskin.messaging.subscription import subscribe

    skin = options.chosen_skin(arguments)
    keys = options.client_keys(arguments)
    if threading.current_thread() is threading.main_thread():  # a script's "&" has it ignore Ctrl-C, which ends it
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if arguments.verified:
        return _verified(arguments, keys)
    subscription = subscribe(
        arguments.endpoint,
        arguments.mode,
        timeout_s=arguments.timeout_s,
        skin=skin,
        maps=not arguments.touches,
        keys=keys,
    )
    show: Callable[[Any], None] | None = None
    states: Any = None
    latencies: list[float] = []
    stages: dict[str, list[float]] = {}
    first_s = time.perf_counter()
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.suppress(KeyboardInterrupt))
        if not arguments.json and not arguments.touches:
            states = subscribe_streams(arguments.endpoint, wire=False, clouds=False, timeout_s=STATE_S, keys=keys)
            stack.enter_context(states)
        for frame in stack.enter_context(subscription):
            if arguments.json:
                latencies.append(frame.latency_s * 1e6)
                for stage, span in frame.stages_us().items():
                    stages.setdefault(stage, []).append(span)
            else:
                show = show or _shown_by(arguments, skin, states, stack)
                show(frame)
            if arguments.frames is not None and subscription.received >= arguments.frames:
                break
            if arguments.seconds is not None and time.perf_counter() - first_s >= arguments.seconds:
                break
    if arguments.json:
        print(json.dumps(_summary(subscription, latencies, stages, time.perf_counter() - first_s)))
    return 0


def _shown_by(
    arguments: argparse.Namespace, skin: "Skin", states: Any, stack: contextlib.ExitStack
) -> Callable[[Any], None]:
    """Return what prints a frame, with places in mm if the runtime says that it has this skin."""
    from eitskin.errors import NoFrame
    from eitskin_tools.console.stream_view import StreamView, describe

    if arguments.touches:
        return _touch_lines(REPEAT_S if arguments.mode == "latest" else 0.0)
    grid = None
    with contextlib.suppress(NoFrame), states:
        grid = skin.grid if states.next_item().grid_id == skin.grid_id else None
    if arguments.mode == "all":
        return lambda frame: say(describe(frame, 0.0, grid))
    view = StreamView(sys.stdout, grid=grid)
    stack.callback(view.end)
    return view.show


def _verified(arguments: argparse.Namespace, keys: Any) -> int:
    """Print verdicts, or count them."""
    from eitskin.messaging.streams.verified_subscription import subscribe_verified
    from eitskin.touches.force import ForceTable
    from eitskin_tools.console.stream_view import describe_verdict

    table = None if arguments.force_table is None else ForceTable.load(arguments.force_table)
    state, checked, flagged, spent_us = ("", ""), 0, 0, list[float]()
    endpoint, timeout_s, first_s = arguments.endpoint, arguments.timeout_s, time.perf_counter()
    with (
        contextlib.suppress(KeyboardInterrupt),
        subscribe_verified(endpoint, arguments.mode, frames=False, timeout_s=timeout_s, keys=keys) as verdicts,
    ):
        for found in verdicts:
            if found.verified:
                checked, flagged = checked + 1, flagged + bool(found.flagged)
                spent_us.append(found.spent_s * 1e6)
            if not arguments.json and (found.verified or (found.state, found.why) != state):
                for line in describe_verdict(found, table):
                    say(line)
            if not found.verified or found.state != state[0]:
                state = found.state, "" if found.verified else found.why
            if arguments.frames is not None and checked >= arguments.frames:
                break
            if arguments.seconds is not None and time.perf_counter() - first_s >= arguments.seconds:
                break
    if arguments.json:
        print(json.dumps(_verified_summary(verdicts, checked, flagged, spent_us)))
    return 0


def _verified_summary(verdicts: Any, checked: int, flagged: int, spent_us: list[float]) -> dict[str, Any]:
    import numpy as np

    from eitskin.pipeline.stats import quantiles

    return {
        "checked": checked, "flagged": flagged, "lost": verdicts.lost, "rejected": verdicts.rejected,
        "extra_us": quantiles(np.array(spent_us)),
    }  # fmt: skip


def _touch_lines(every_s: float) -> Callable[[Any], None]:
    """Return what prints the touches of a frame, every so often, and what happened to them."""
    due_s = [0.0]

    def show(frame: Any) -> None:
        for event in frame.touch_list.events:
            say(f"{frame.sequence} touch {event.id} {event.kind}{f' {event.other}' if event.other else ''}")
        if time.monotonic() < due_s[0]:
            return
        due_s[0] = time.monotonic() + every_s
        for touch in frame.touches:
            say(f"{frame.sequence} {touch}")
        if frame.touch_list.more:
            say(f"{frame.sequence} and {frame.touch_list.more} more touches")

    return show


def _summary(
    subscription: Any, latencies: list[float], stages: dict[str, list[float]], elapsed_s: float
) -> dict[str, Any]:
    import numpy as np

    from eitskin.pipeline.stats import quantiles

    return {
        "frames": subscription.received,
        "rate_hz": round(subscription.received / elapsed_s, 3) if elapsed_s > 0 else 0.0,
        "lost": subscription.lost,
        "rejected": subscription.rejected,
        "mapless": subscription.mapless,
        "latency_us": quantiles(np.array(latencies)),
        "stages_us": {stage: quantiles(np.array(spans)) for stage, spans in stages.items()},
    }
