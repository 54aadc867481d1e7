"""``eitskin replay``: publish a recording as if its skin were there, through the same runtime and topics."""

import argparse
import contextlib
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

from eitskin_tools.command_line.options import add_bundle, add_span, check_span
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.signals import endings
from eitskin_tools.verifier import options as verifier

SPEEDS = (1e-3, 1e6)
"""Frames that came 5 ms apart are 5 s apart, and all come at once."""

POLL_S = 0.01
"""Between two checks for a subscriber, with --wait."""

SETTLED_S = 0.5
"""Nothing else was subscribed to for this long: a program that wants frames and streams makes two connections."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", type=Path, metavar="FILE.mcap", help="made by 'eitskin record'")
    parser.add_argument("--publish", metavar="ENDPOINT", help="ipc:///path, or tcp:// with keys (default: ipc)")
    parser.add_argument("--control", metavar="ENDPOINT", help="ipc:///path, or tcp:// with keys (default: ipc)")
    parser.add_argument("--curve-keys", type=Path, metavar="DIR", help="CURVE keys, which TCP needs")
    add_bundle(parser, "to use (default: the one that was running)")
    parser.add_argument("--solver", metavar="NAME", help="most accurate solver to use (default: the one that ran)")
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        "--as-fast-as-possible", action="store_true", help="publish each frame as soon as the last is done"
    )
    pace.add_argument("--speed", type=float, default=1.0, metavar="X", help="play at X times the recorded pace")
    parser.add_argument("--loop", action="store_true", help="repeat until Ctrl-C")
    add_span(parser)
    verifier.add_arguments(parser)
    parser.add_argument("--wait", action="store_true", help="begin half a second after the first subscription")
    parser.add_argument("--quiet", action="store_true", help="log only 'ready' and problems")


def run(arguments: argparse.Namespace) -> int:
    """Play until the end, SIGINT, SIGTERM, SIGHUP or ``stop``; return 0."""
    _check(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from eitskin.messaging import endpoints
    from eitskin.messaging.control import ControlServer
    from eitskin.messaging.curve_keys import load_server_keys
    from eitskin.messaging.publish import Publisher
    from eitskin.skin import serve
    from eitskin_tools.console.run_log import RunLog
    from eitskin_tools.recording.replay import Player, ReplayOptions
    from eitskin_tools.recording.script import Script

    log = RunLog(sys.stderr, quiet=arguments.quiet, command="replay")
    keys = None if arguments.curve_keys is None else load_server_keys(arguments.curve_keys)
    script = Script(arguments.file)
    say = log.warn if script.ending else log.say
    say(f"{script.path}: {script.seconds:.1f} s of {script.head_text('serial')}{script.ending}")
    manner = ReplayOptions(
        not arguments.as_fast_as_possible, arguments.loop, arguments.from_s, arguments.to_s, arguments.speed
    )
    with contextlib.ExitStack() as stack:
        player = stack.enter_context(
            Player(script, manner, bundle=arguments.bundle, solver=arguments.solver, tell=log.warn)
        )
        skin = player.skin
        publisher = Publisher(arguments.publish or endpoints.default_publish(), keys)
        stack.callback(publisher.close)
        control = ControlServer(arguments.control or endpoints.default_control(), skin, keys)
        stack.callback(control.close)
        stack.callback(skin.stop)
        for number in endings():
            signal.signal(number, lambda *_: skin.stop())
        for line in player.line.report():
            log.say(line)
        with verifier.verifying(skin, publisher, arguments, is_replay=True) as behind:
            log.ready(publisher.endpoint, control.endpoint)
            if arguments.wait:
                _wait(skin, publisher)
            serve(skin, publisher, behind=behind)
        found = {**skin.summary(), "sent": player.line.sent, "rounds": player.line.rounds}
    if script.recording.damaged:
        log.warn(f"{script.path}{script.ending}")
    if arguments.json:
        print(json.dumps(found))
    else:
        log.say(_closing(found))
    return 0


def _closing(found: dict[str, Any]) -> str:
    """Return how many frames were played and published, in a line."""
    lost = f", {found['lost']} lost when recorded"
    if found["published"] == 0:
        return f"{found['sent']} frames played{lost}; nobody subscribed"
    return f"{found['sent']} frames played, {found['published']} published{lost}"


def _wait(skin: Any, publisher: Any) -> None:
    """Return once a program has subscribed and ``SETTLED_S`` passed without another topic, or on an end."""
    found, since_s = publisher.topics, time.monotonic()
    while not skin.stopping:
        publisher.update()
        if (topics := publisher.topics) != found:
            found, since_s = topics, time.monotonic()
        if (publisher.wanted or publisher.streams.asked) and time.monotonic() - since_s >= SETTLED_S:
            return
        time.sleep(POLL_S)


def _check(arguments: argparse.Namespace) -> None:
    verifier.check(arguments)
    if not SPEEDS[0] <= arguments.speed <= SPEEDS[1]:
        raise UsageError(f"--speed is {arguments.speed:g}, expected {SPEEDS[0]:g} to {SPEEDS[1]:g}")
    check_span(arguments)
