"""``eitskin reinfer``: compute the maps of a recording again, with the same bundle and solver or with others."""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files, kinds, needs, options
from eitskin_tools.command_line.options import add_span, check_span
from eitskin_tools.errors import UsageError

MAX_MAPS = 200_000
"""Maps in a file: a gigabyte of memory."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", type=Path, metavar="FILE.mcap", help="made by 'eitskin record'")
    options.add_bundle(parser, "to use (default: the one that was running)")
    parser.add_argument(
        "--recorded-bundle",
        type=files.bundle,
        metavar="FILE",
        help="the bundle that was running, if it is not a shipped one",
    )
    parser.add_argument(
        "--solver",
        metavar="NAME",
        help="vd2t, vd2t-int8, vd2t-small, tikhonov, or 'verified' (extra: sim)",
    )
    parser.add_argument(
        "--every", type=int, default=1, metavar="N", help="with another solver: compute one frame in N (default 1)"
    )
    add_span(parser)
    parser.add_argument("--out", type=Path, metavar="MAPS.npz", help="write the maps")
    parser.add_argument("--quiet", action="store_true", help="show no progress")


def run(arguments: argparse.Namespace) -> int:
    """Compute, compare, and return 0; 1 if maps that should be the same differ."""
    _check(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from eitskin_tools.console.terminal import StatusLine, answer
    from eitskin_tools.recording.reinfer import VERIFIED, comparison_solver, reinfer
    from eitskin_tools.recording.script import Script, bundle_of

    script = Script(arguments.file)
    recorded = _recorded(script, arguments)
    other: Any
    if arguments.solver == VERIFIED:
        needs.require("--solver verified", ("scipy",))
        from eitskin_tools.evaluation.verified.recorded import VerifiedSolver

        other = VerifiedSolver(script, recorded if arguments.bundle is None else bundle_of(script, arguments.bundle))
    else:
        other = comparison_solver(script, recorded, arguments.bundle, arguments.solver)
    line = StatusLine(sys.stderr)

    def progress(done_s: float, of_s: float) -> None:
        if not arguments.quiet:
            line.show(f"{done_s:.0f} of {of_s:.0f} s computed")

    found = reinfer(
        script,
        recorded,
        other,
        from_s=arguments.from_s,
        to_s=arguments.to_s,
        every=arguments.every,
        keep=MAX_MAPS if arguments.out else 0,
        progress=progress,
    )
    line.end()
    if script.ending:
        print(f"eitskin reinfer: {script.path}{script.ending}", file=sys.stderr)
    if arguments.out is not None:
        from eitskin_tools.recording.reinfer import write

        write(arguments.out, found)
    fields = {"file": str(script.path), "bundle": recorded.id, "solver": arguments.solver, **found.fields()}
    fields["as_recorded"] = recorded.id == script.head_text("bundle")
    if other is not None:
        fields["other_bundle"] = getattr(other, "bundle_id", "")
    answer(arguments, fields, *_lines(fields))
    return 1 if found.equality is not None and found.equality.differing else 0


def _recorded(script: Any, arguments: argparse.Namespace) -> Any:
    """Return the bundle that was running; where it is not there, the one that is named instead."""
    from eitskin_tools.recording.layout import RecordingError
    from eitskin_tools.recording.script import bundle_of

    if arguments.recorded_bundle is not None:
        return bundle_of(script, arguments.recorded_bundle)
    try:
        return bundle_of(script)
    except RecordingError:
        if arguments.bundle is None:
            raise
        return bundle_of(script, arguments.bundle)


def _lines(found: dict[str, Any]) -> list[str]:
    """Return the result as lines for people."""
    from eitskin_tools.recording.reinfer import unknown_clause

    lines = [
        f"{found['frames']} frames, {found['withheld']} of them withheld, in {found['elapsed_s']:.1f} s: "
        f"{found['frames_per_s']:.0f} frames/s, {found['times_real_time'] or 0:.1f} times real time"
    ]
    if "published" in found:
        differing = ", ".join(f"{count} by {why}" for why, count in found["differing"].items())
        lines.append(
            f"{found['equal']} of {found['published']} published maps are bit-equal"
            + unknown_clause(found)
            + (f"; differing: {differing}, first at frame {found['first_differing']}" if differing else "")
        )
    elif not found["as_recorded"]:
        lines.append("not compared: name the bundle of the recording with --recorded-bundle")
    elif "against_recorded" not in found:
        lines.append("not compared: the recording has no digests of its maps")
    if (against := found.get("against_recorded")) is not None:
        median, low = _number(against["cc_median"], ".3f"), _number(against["cc_p5"], ".3f")
        near, far = _number(against["centre_mm_median"], ".2f"), _number(against["centre_mm_p95"], ".2f")
        lines.append(
            f"compared with the recorded bundle in {against['frames']} frames: {_share(against['touched_agreement'])} "
            f"agree on touched or not; in the {against['both_touched']} touched in both: CC {median} median, {low} 5th "
            f"percentile; centres {near} mm apart median, {far} mm 95th percentile"
        )
    if (verified := found.get("verified")) is not None:
        lines += _verdicts(verified)
    return lines


def _verdicts(found: dict[str, Any]) -> list[str]:
    """Return the verifier's results, a line each."""
    lines = []
    if found["frames"]:
        lines.append(
            f"verified {found['frames']} touched frames: {_share(found['flagged_share'])} flagged; p "
            f"{_number(found['p_value_median'], '.3g')} median; {found['ms_median']:.1f} ms a frame median, "
            f"{found['ms_p95']:.1f} ms 95th percentile"
        )
    elif not found["not_verified"]:
        lines.append("nothing to verify: no frame of this part was touched")
    return lines + [f"{count} touched frames not verified: {why}" for why, count in found["not_verified"].items()]


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"


def _check(arguments: argparse.Namespace) -> None:
    if arguments.every < 1:
        raise UsageError(f"--every is {arguments.every}, expected at least 1")
    check_span(arguments)
    if arguments.out is not None:
        files.writable(arguments.out, kinds.COMPUTED)
