"""``eitskin run``: read a skin, publish frames and answer control requests until it is stopped.

Standard error logs the start line by line, then ``ready ...``, then the state of the stream at most once a second.
Standard output stays empty but for the one object of ``--json`` at the end.
"""

import argparse
import contextlib
import gc
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eitskin.pipeline.latency_budget import MOST_MS
from eitskin_tools.command_line import options
from eitskin_tools.command_line.options import flag
from eitskin_tools.command_line.parser import CPUS, Parser, positive, whole
from eitskin_tools.console.run_log import FORMATS, RunLog, end_unread
from eitskin_tools.console.run_status import closing, report
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.signals import endings
from eitskin_tools.verifier import options as verifier

if TYPE_CHECKING:
    from eitskin.messaging.curve_keys import ServerKeys
    from eitskin_tools.service.supervisor import Supervisor
    from eitskin_tools.service.watchdog import Watchdog


def add_arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("--port", help="serial port of the skin, usb:SERIAL, or NAME:REST of a driver")
    parser.add_argument("--config", type=Path, metavar="FILE.toml", help="run all skins that a robot.toml lists")
    options.add_touches(parser, "those of --skin, else raise", "touches to expect")
    options.add_bundle(parser, "to use (default: the shipped one for these touches)")
    parser.add_argument(
        "--reference", type=Path, metavar="FILE", help="a reference captured earlier (default: capture one now)"
    )
    parser.add_argument("--skin", type=Path, metavar="FILE", help="description of the sheet, which the bundle must fit")
    options.add_reconnect(parser)
    parser.add_argument("--seconds", type=positive(1e9), metavar="S", help="end after S seconds")
    parser.add_argument("--frames", type=whole(1), metavar="N", help="end after N frames")
    parser.add_argument("--quiet", action="store_true", help="log only 'ready' and problems")

    group = parser.add_more("network")
    group.add_argument("--publish", metavar="ENDPOINT", help="ipc:///path, or tcp:// with keys (default: ipc)")
    group.add_argument("--control", metavar="ENDPOINT", help="ipc:///path, or tcp:// with keys (default: ipc)")
    group.add_argument("--curve-keys", type=Path, metavar="DIR", help="CURVE keys, which TCP needs")

    group = parser.add_more("device and reference")
    group.add_argument("--baud", type=whole(300), help="bits per second of a UART (default 2000000)")
    group.add_argument("--check", action="store_true", help="with --config: check the file and what it names, and end")
    group.add_argument(
        "--reference-frames",
        type=whole(2, 10_000),
        metavar="N",
        help="frames of a reference captured now (default 100)",
    )
    group.add_argument(
        "--force-reference", action="store_true", help="capture it even if the sheet seems bent, touched or moving"
    )
    group.add_argument(
        "--exclude-electrode",
        type=whole(0, 15),
        action="append",
        default=[],
        metavar="N",
        help="work without electrode N, 0 to 15; may be repeated",
    )

    group = parser.add_more("solving")
    group.add_argument(
        "--solver",
        metavar="NAME",
        help="most accurate solver to use: vd2t, vd2t-int8, vd2t-small or tikhonov (default: vd2t, or vd2t-int8 if "
        "the bundle's card reports equal accuracy and no budget is set)",
    )
    group.add_argument(
        "--budget-ms",
        type=positive(MOST_MS),
        metavar="B",
        help="latency budget in ms, from read to publish (default: none)",
    )
    group.add_argument(
        "--every-map", action="store_true", help="compute every touched frame, even if only noise changed"
    )
    group.add_argument(
        "--idle-after", type=positive(1e9), metavar="S", help="scan only a few drives after S seconds without a touch"
    )
    group.add_argument(
        "--compensate-drift",
        action=argparse.BooleanOptionalAction,
        help="correct for drift since the reference (default: if the bundle can)",
    )

    verifier.add_arguments(parser.add_more("verification"))

    group = parser.add_more("real time")
    group.add_argument("--sched-fifo", type=int, metavar="PRIORITY", help="request SCHED_FIFO at this priority")
    group.add_argument("--affinity", type=CPUS, metavar="CPUS", help="run on these CPUs only, such as 2 or 2,3")
    group.add_argument("--mlock", action="store_true", help="keep all pages in memory")

    group = parser.add_more("log")
    group.add_argument("--log-format", choices=FORMATS, default="text", help="text, or json for an object a line")


def run(arguments: argparse.Namespace) -> int:
    """Run until SIGINT, SIGTERM, SIGHUP, ``stop``, a number of frames or a time; return 0."""
    _check(arguments)
    if arguments.config is not None:
        from eitskin_tools.robot.command import run_all

        return run_all(arguments, add_arguments)
    for number in endings():  # until there is something to close, at once, and not as an error amid some import
        signal.signal(number, signal.SIG_DFL)
    log = RunLog(sys.stderr, arguments.log_format, quiet=arguments.quiet)
    # One inference thread means one: numpy's BLAS would start a pool as soon as it is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.disable()  # while modules and weights are loaded, which leave nothing to collect; settle() turns it on again
    from eitskin.diagnostics import realtime
    from eitskin.skin import Skin
    from eitskin_tools.service.supervisor import Supervisor
    from eitskin_tools.service.watchdog import END_S, Watchdog

    with contextlib.ExitStack() as stack:
        stack.push(end_unread)
        stack.callback(gc.enable)
        supervisor = Supervisor.of(os.environ)
        stack.callback(supervisor.close)
        watchdog = stack.enter_context(Watchdog(log.failed, supervisor))
        keys = _check_endpoints(arguments)
        open_files = realtime.more_files()  # said once the port is open, so that a missing port is one line
        if arguments.affinity:
            log.say(realtime.pin(list(arguments.affinity)))
        keywords: dict[str, Any] = {} if arguments.baud is None else {"baud": arguments.baud}
        port = arguments.port
        if arguments.reconnect is not None:
            from eitskin.acquisition.hotplug import HotPlug

            port = HotPlug(arguments.port, **keywords, give_up_s=arguments.reconnect)
            if port.gone:
                log.say(f"waiting up to {arguments.reconnect:g} s: {port.trouble}")
        skin = stack.enter_context(
            Skin(
                port,
                bundle=arguments.bundle,
                touches=arguments.touches,
                skin=arguments.skin,
                reference=arguments.reference,
                budget_ms=arguments.budget_ms,
                solver=arguments.solver,
                skip_unchanged=not arguments.every_map,
                idle_after_s=arguments.idle_after,
                exclude=tuple(arguments.exclude_electrode),
                compensate_drift=arguments.compensate_drift,
                **keywords,
            )
        )
        for number in endings():
            signal.signal(number, lambda *_: skin.stop())
        report(skin, log, _said_by(arguments))
        log.say(open_files)
        if arguments.sched_fifo is not None:
            log.say(realtime.schedule_fifo(arguments.sched_fifo))
        if arguments.mlock:
            log.say(realtime.lock_memory())
        try:
            _serve(skin, arguments, keys, stack, log, watchdog, supervisor)
        finally:
            watchdog.watch("closing everything", limit_s=END_S)
        if arguments.json:
            print(json.dumps(skin.summary()))
        else:
            log.say(closing(skin.summary()))
    return 0


def _said_by(arguments: argparse.Namespace) -> str:
    """Return what says which touches are expected."""
    if arguments.touches is not None:
        return "--touches"
    if arguments.bundle is not None:
        return "--bundle"
    return "the shipped bundle" if arguments.skin is None else f"skin {arguments.skin.name}"


def _serve(
    skin: Any,
    arguments: argparse.Namespace,
    keys: "ServerKeys | None",
    stack: contextlib.ExitStack,
    log: RunLog,
    watchdog: "Watchdog",
    supervisor: "Supervisor",
) -> None:
    from eitskin.diagnostics import realtime
    from eitskin.errors import BadReference
    from eitskin.messaging import endpoints
    from eitskin.messaging.control import ControlServer
    from eitskin.messaging.publish import Publisher
    from eitskin.reference.captured import DEFAULT_FRAMES
    from eitskin.skin import serve
    from eitskin_tools.console.run_status import RunStatus
    from eitskin_tools.service.watchdog import WatchedLine

    publisher = Publisher(arguments.publish or endpoints.default_publish(), keys)
    stack.callback(publisher.close)
    control = ControlServer(arguments.control or endpoints.default_control(), skin, keys)
    stack.callback(control.close)
    stack.callback(skin.stop)  # a client that waits for a reference is told before control is closed
    stack.callback(supervisor.stopping)
    watchdog.sockets += [
        Path(where.removeprefix("ipc://")) for where in (publisher.endpoint, control.endpoint) if where[:4] == "ipc:"
    ]
    line = skin.device.transport = WatchedLine(skin.device.transport)
    realtime.settle()  # 60 ms that would otherwise pass between the reference and the first frame
    watchdog.watch("the frame loop", line)
    if skin.reference is None:
        frames = arguments.reference_frames or DEFAULT_FRAMES
        log.say(f"reference: capturing {frames} frames; the sheet must lie flat, untouched")
        supervisor.status("capturing the reference; the sheet must lie flat, untouched")
        try:
            skin.capture_reference(frames, force=arguments.force_reference)
        except BadReference:
            if skin.stopping:
                return
            raise
    for line in skin.reference.report():
        log.say(line)
    unread = arguments.quiet and not supervisor.listens
    with verifier.verifying(skin, publisher, arguments) as behind:
        log.ready(publisher.endpoint, control.endpoint)
        supervisor.ready()
        supervisor.status(f"publishing on {publisher.endpoint}")
        until_ns = None if arguments.seconds is None else time.perf_counter_ns() + int(arguments.seconds * 1e9)
        with contextlib.nullcontext() if unread else RunStatus(skin.status, log, tell=supervisor.status):
            serve(skin, publisher, frames=arguments.frames, until_ns=until_ns, behind=behind)


def _check(arguments: argparse.Namespace) -> None:
    if (arguments.port is None) == (arguments.config is None):
        raise UsageError("expected either --port PORT for one skin, or --config FILE.toml for several")
    if arguments.check and arguments.config is None:
        raise UsageError("--check needs --config: it checks a robot.toml")
    options.check_solver(arguments)
    for name in ("reference_frames", "force_reference"):
        if arguments.reference is not None and getattr(arguments, name):
            raise UsageError(f"{flag(name)} is for capturing a reference: leave out either it or --reference")
    verifier.check(arguments)


def _check_endpoints(arguments: argparse.Namespace) -> "ServerKeys | None":
    """Refuse endpoints and keys that cannot be used, before the device is touched; return the keys."""
    from eitskin.messaging import endpoints
    from eitskin.messaging.curve_keys import load_server_keys

    keys = None if arguments.curve_keys is None else load_server_keys(arguments.curve_keys)
    for endpoint in (arguments.publish, arguments.control):
        if endpoint is not None:
            endpoints.check_allowed(endpoint, keys)
    return keys
