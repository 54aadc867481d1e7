"""``eitskin plot``: a picture of a recording."""

import argparse
import os
import sys
from pathlib import Path

from eitskin_tools.command_line import files, options
from eitskin_tools.command_line.options import add_span, check_span


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", type=Path, metavar="FILE.mcap", help="made by 'eitskin record'")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png", help="the picture; also .pdf, .svg, ...")
    options.add_bundle(parser, "that computes the maps (default: the one that was running)")
    add_span(parser)
    parser.add_argument("--quiet", action="store_true", help="show no progress")


def run(arguments: argparse.Namespace) -> int:
    """Draw, and return 0."""
    check_span(arguments)
    files.picture(arguments.out)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from eitskin_tools.console.terminal import StatusLine, answer
    from eitskin_tools.recording.plot import course_of, draw
    from eitskin_tools.recording.script import Script, bundle_of

    script = Script(arguments.file)
    bundle = bundle_of(script, arguments.bundle)
    line = StatusLine(sys.stderr)

    def progress(done_s: float, of_s: float) -> None:
        if not arguments.quiet:
            line.show(f"{done_s:.0f} of {of_s:.0f} s computed")

    course = course_of(script, bundle, arguments.from_s, arguments.to_s, progress)
    line.end()
    if script.ending:
        print(f"eitskin plot: {script.path}{script.ending}", file=sys.stderr)
    touched = sum(count > 0 for count in course.touches)
    said = (
        f"{len(course.times_s)} frames in {course.end_s - course.begin_s:.1f} s, {touched} of them with touches, at "
        f"most {max(course.touches)} at once"
    )
    draw(arguments.out, course, f"{arguments.file.name}: {said}", bundle.skin.outline.size_mm)
    found = {"frames": len(course.times_s), "touched": touched, "most_touches": max(course.touches)}
    return answer(arguments, {"out": str(arguments.out), **found}, f"{arguments.out}: {said}")
