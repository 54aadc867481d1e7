"""``eitskin record``: write what a runtime measures into a file, until told to stop.

A process of its own, so that no frame waits for a disk. The file can be read to the last three tenths of a second
whatever ends this process; it opens in Foxglove.
"""

import argparse
import contextlib
import json
import signal
import sys
import time
from pathlib import Path
from typing import Any

from eitskin.errors import NoFrame
from eitskin_tools.command_line import files
from eitskin_tools.command_line.options import add_client_keys, client_keys
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.signals import endings

POLL_S = 0.25
"""How long it waits at most for what comes."""

MIN_WAIT_S = 0.03
"""How long it waits at least: a stream's next frame comes first, and ends the chunk that is due."""

SILENCE_S = 1.0
"""Where nothing has come for so long, nothing is on its way."""

PICTURES_HZ = 30.0
"""Pictures a second, unless it is said."""

SKIN_TIMEOUT_S = 10.0
"""How long a runtime may take to say what skin it has."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("endpoint", nargs="?", help="where the runtime publishes (default: its default)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.mcap", help="file to write; it must be new")
    parser.add_argument("--maps", action="store_true", help="store maps (default: a digest of each)")
    parser.add_argument("--every", type=int, metavar="N", help="with --maps: store one map in N (default 1)")
    parser.add_argument(
        "--wire-only",
        action="store_true",
        help="store no digests or pictures, so that the runtime computes no map for the recorder",
    )
    parser.add_argument(
        "--pictures-hz", type=float, metavar="HZ", help=f"pictures a second for Foxglove (default {PICTURES_HZ:g})"
    )
    parser.add_argument("--rotate-mb", type=float, metavar="MB", help="begin a new file after MB megabytes")
    parser.add_argument("--rotate-minutes", type=float, metavar="M", help="begin a new file after M minutes")
    parser.add_argument("--seconds", type=float, metavar="S", help="end after S seconds")
    parser.add_argument("--frames", type=int, metavar="N", help="end after N frames")
    parser.add_argument("--timeout-s", type=float, metavar="T", help="end after T s without a frame (default: wait)")
    add_client_keys(parser)
    parser.add_argument("--quiet", action="store_true", help="log only problems")


def run(arguments: argparse.Namespace) -> int:
    """Record until SIGINT, SIGTERM, SIGHUP, a number of frames or a time; return 0, or 1 when the disk was full."""
    _check(arguments)
    from eitskin.messaging.streams.subscription import subscribe_streams
    from eitskin.messaging.subscription import subscribe
    from eitskin_tools.recording.recorder import Recorder, RecorderOptions, SubscriptionQueue
    from eitskin_tools.recording.writer import Series

    keys = client_keys(arguments)
    stopped = _Stop()
    for number in endings():
        signal.signal(number, stopped)
    most_bytes = None if arguments.rotate_mb is None else round(arguments.rotate_mb * 1e6)
    most_s = None if arguments.rotate_minutes is None else arguments.rotate_minutes * 60.0

    def opener(head: dict[str, str]) -> Series:
        return Series(arguments.out, head, most_bytes=most_bytes, most_s=most_s)

    def frames() -> Any:
        return subscribe(arguments.endpoint, "all", timeout_s=POLL_S, skip_unchanged=True, patient=True, keys=keys)

    def streams() -> Any:
        return subscribe_streams(arguments.endpoint, timeout_s=POLL_S, keys=keys)

    sources = [streams] if arguments.wire_only else [streams, frames]
    pictures_hz = PICTURES_HZ if arguments.pictures_hz is None else arguments.pictures_hz
    kept = RecorderOptions(arguments.maps, arguments.every or 1, 0.0 if arguments.wire_only else pictures_hz)
    recorder = Recorder(opener, kept)
    with contextlib.ExitStack() as stack:
        intake = SubscriptionQueue(sources)
        stack.callback(recorder.close)
        stack.callback(intake.close)
        full = _go_on(arguments, recorder, intake, stopped)
    if arguments.json:
        print(json.dumps(_summary(recorder, intake)))
    elif not arguments.quiet and not full:
        print(f"eitskin record: {_text(recorder)}", file=sys.stderr)
    if full:
        print(
            f"eitskin record: the disk is full: {_text(recorder)}; the file is complete, free some space",
            file=sys.stderr,
        )
    return 1 if full else 0


class _Stop:
    """Remembers the request to stop."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, *_: object) -> None:
        self.asked = True


def _go_on(arguments: argparse.Namespace, recorder: Any, intake: Any, stopped: _Stop) -> bool:
    """Record until the end, and return whether the disk was full."""
    from eitskin_tools.console.terminal import StatusLine

    line = StatusLine(sys.stderr)
    begin_s = first_s = heard_s = shown_s = time.monotonic()
    with contextlib.ExitStack() as stack:
        stack.callback(line.end)
        while not stopped.asked:
            found = intake.next(_wait_s(recorder.series))
            now_s = time.monotonic()
            if found is not None:
                heard_s = now_s
                recorder.record(found)
            elif recorder.series is not None:
                recorder.series.sync()
            if recorder.full:
                return True
            if recorder.series is None and now_s - begin_s > (patience_s := arguments.timeout_s or SKIN_TIMEOUT_S):
                raise intake.unusable or _nothing(arguments.endpoint, patience_s, silent=intake.silent is not None)
            if arguments.timeout_s is not None and now_s - heard_s > arguments.timeout_s:
                return False
            if not recorder.frames:
                first_s = now_s
            if arguments.seconds is not None and recorder.recorded_s >= arguments.seconds:
                return False
            if arguments.seconds is not None and now_s - max(first_s + arguments.seconds, heard_s + SILENCE_S) >= 0.0:
                return False  # the time is over, and the rest of it never came
            if arguments.frames is not None and recorder.frames >= arguments.frames:
                return False
            if line.live and not arguments.quiet and now_s - shown_s >= 1.0:
                shown_s = now_s
                line.show(_text(recorder) + ("; no frames arrive" if now_s - heard_s > SILENCE_S else ""))
    return False


def _nothing(endpoint: str | None, waited_s: float, *, silent: bool) -> NoFrame:
    """Return what to say of a stream of which nothing came, or nothing that a recording begins with."""
    from eitskin.messaging.endpoints import default_publish
    from eitskin.messaging.reachability import explain_silence

    if not silent:
        return NoFrame("the runtime is too old to be recorded: it does not describe its skin; update it")
    where = endpoint or default_publish()
    return NoFrame(f"no stream from {where} within {waited_s:g} s: {explain_silence(where, waited_s)}")


def _wait_s(series: Any) -> float:
    """Return how long to wait for what comes: where nothing does, what waits in memory is written when it is due."""
    return POLL_S if series is None else min(max(series.due_s, MIN_WAIT_S), POLL_S)


def _text(recorder: Any) -> str:
    """Return how far it is, in a line."""
    series = recorder.series
    if series is None:
        return "waiting for the runtime"
    more = f" and {len(series.files) - 1} earlier files" if len(series.files) > 1 else ""
    return (
        f"{recorder.recorded_s:.1f} s, {recorder.frames} frames, {recorder.missed} missed, "
        f"{series.size / 1e6:.2f} MB in {series.path}{more}"
    )


def _summary(recorder: Any, intake: Any) -> dict[str, Any]:
    series = recorder.series
    return {
        "frames": recorder.frames,
        "missed": recorder.missed,
        "published": recorder.published,
        "seconds": round(recorder.recorded_s, 3),
        "bytes": 0 if series is None else series.size,
        "files": [] if series is None else [str(path) for path in series.files],
        "dropped": intake.dropped,
        "full": recorder.full,
    }


def _check(arguments: argparse.Namespace) -> None:
    if arguments.wire_only and (arguments.maps or arguments.pictures_hz):
        raise UsageError("--wire-only records neither maps nor pictures: leave out --maps and --pictures-hz")
    if arguments.every is not None and not arguments.maps:
        raise UsageError("--every chooses which maps are recorded: it needs --maps")
    for name in ("every", "rotate_mb", "rotate_minutes", "seconds", "frames", "timeout_s"):
        value = getattr(arguments, name)
        if value is not None and not 0 < value < 1e9:
            raise UsageError(f"--{name.replace('_', '-')} is {value}, expected more than 0")
    if arguments.pictures_hz is not None and not 0.0 <= arguments.pictures_hz <= 1000.0:
        raise UsageError(f"--pictures-hz is {arguments.pictures_hz:g}, expected 0 to 1000")
    files.writable(arguments.out, None)
    if arguments.out.exists():
        raise UsageError(f"--out {arguments.out} already exists: name another file, or move it away")
