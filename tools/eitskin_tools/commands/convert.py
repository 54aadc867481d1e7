"""``eitskin convert``: a recording as NPZ, Parquet, CSV or rosbag2."""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files, kinds, needs
from eitskin_tools.command_line.options import add_bundle, add_span, check_span
from eitskin_tools.command_line.parser import expected_one_of, positive
from eitskin_tools.console.terminal import answer
from eitskin_tools.errors import UsageError

FORMATS = {".npz": "npz", ".parquet": "parquet", ".csv": "csv", "": "rosbag2"}
"""By the end of the name; a folder has none."""

OUTPUT_KINDS = {"npz": kinds.CONVERTED, "parquet": kinds.PARQUET, "csv": kinds.CSV}

NEEDED_MODULES = {"npz": (), "parquet": ("pyarrow",), "csv": (), "rosbag2": ("rosbags",)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", type=Path, metavar="FILE.mcap", help="made by 'eitskin record'")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="OUT", help="X.npz, .parquet or .csv, or a new folder for rosbag2"
    )
    parser.add_argument("--format", choices=tuple(NEEDED_MODULES), help="default: from the ending of OUT")
    parser.add_argument(
        "--rosbag-version", type=int, choices=(8, 9), metavar="N", help="8 for ROS 2 Humble, 9 for Jazzy (default 9)"
    )
    parser.add_argument("--rate", type=positive(1e5), metavar="HZ", help="rows a second (default: a row a frame)")
    parser.add_argument(
        "--clock", type=Path, metavar="FILE", help="rows at the times in FILE: a line each, in seconds since 1970"
    )
    add_bundle(parser, "that computes the touches (default: the one that was running)")
    add_span(parser)


def run(arguments: argparse.Namespace) -> int:
    """Convert, and return 0."""
    kind = arguments.format or FORMATS.get(arguments.out.suffix)
    if kind is None:
        raise UsageError(
            expected_one_of("the end of --out", arguments.out.suffix, (".npz", ".parquet", ".csv", "none"))
        )
    check_span(arguments)
    needs.require(f"convert to {kind}", NEEDED_MODULES[kind])
    files.parent(arguments.out) if kind == "rosbag2" else files.writable(arguments.out, OUTPUT_KINDS[kind])
    if arguments.rosbag_version is not None and kind != "rosbag2":
        raise UsageError(f"--rosbag-version is for rosbag2, found {kind}: name a folder with --out")
    if (arguments.rate or arguments.clock) and kind == "rosbag2":
        raise UsageError("--rate and --clock do nothing with rosbag2, which has each frame: leave them out")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from eitskin_tools.recording import convert, resample
    from eitskin_tools.recording.script import Script

    script = Script(arguments.file)
    frames = _frames(script, arguments.bundle)
    found: dict[str, Any] = {"file": str(script.path), "out": str(arguments.out), "format": kind}
    span = arguments.from_s, arguments.to_s
    if kind == "rosbag2":
        version: Any = arguments.rosbag_version or 9
        found["messages"] = convert.write_rosbag(arguments.out, script, *span, frames=frames, version=version)
        said = f"{found['messages']} messages"
    else:
        times_ns = resample.clock_ns(arguments.clock, arguments.rate) if arguments.clock else None
        table = convert.table_of(script, *span, frames)
        if arguments.rate and times_ns is None:
            times_ns = resample.regular_ns(table, arguments.rate)
        if times_ns is not None:
            table = resample.resampled(table, times_ns)
        write = {"npz": convert.write_npz, "parquet": convert.write_parquet, "csv": convert.write_csv}[kind]
        write(arguments.out, table, script)
        found |= {"frames": len(table.voltages_V), "left_out": table.left_out, "maps": table.maps is not None}
        said = f"{found['frames']} frames, {table.left_out} idle scans of a few drives left out"
        if times_ns is not None:
            found["without_frame"] = len(times_ns) - found["frames"]
            said += f", {found['without_frame']} times without a frame"
        if table.later.any():
            found["later_reference"] = count = int(table.later.sum())
            begin_s = (table.columns["wall_ns"][table.later][0] - script.first_ns) * 1e-9
            print(
                f"eitskin convert: {script.path}: {count} frames, from {begin_s:.3f} s on, used a later reference "
                "than reference_V; convert them separately with --from and --to",
                file=sys.stderr,
            )
    if script.ending:
        print(f"eitskin convert: {script.path}{script.ending}", file=sys.stderr)
    found["touches"] = frames is not None
    if frames is None:
        said += "; no touches, because the bundle that was running is not a shipped one: name it with --bundle FILE"
    return answer(arguments, found, f"{arguments.out}: {said}")


def _frames(script: Any, bundle: Path | None) -> Any:
    """Return what computes the touches; None where the bundle that was running is not there."""
    from eitskin_tools.recording.frames import RecordedFrames
    from eitskin_tools.recording.layout import RecordingError
    from eitskin_tools.recording.script import bundle_of

    try:
        return RecordedFrames(script, bundle_of(script, bundle))
    except RecordingError:
        if bundle is not None:
            raise
        return None
