"""``eitskin convert``: a recording as NPZ, Parquet or rosbag2."""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files, kinds, needs
from eitskin_tools.command_line.options import add_bundle, add_span, check_span
from eitskin_tools.command_line.parser import expected_one_of
from eitskin_tools.console.terminal import answer
from eitskin_tools.errors import UsageError

FORMATS = {".npz": "npz", ".parquet": "parquet", "": "rosbag2"}
"""By the end of the name; a folder has none."""

OUTPUT_KINDS = {"npz": kinds.CONVERTED, "parquet": kinds.PARQUET}

NEEDED_MODULES = {"npz": (), "parquet": ("pyarrow",), "rosbag2": ("rosbags",)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", type=Path, metavar="FILE.mcap", help="made by 'eitskin record'")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="OUT", help="X.npz, X.parquet, or a new folder for rosbag2"
    )
    parser.add_argument("--format", choices=tuple(NEEDED_MODULES), help="default: from the ending of OUT")
    parser.add_argument(
        "--rosbag-version", type=int, choices=(8, 9), metavar="N", help="8 for ROS 2 Humble, 9 for Jazzy (default 9)"
    )
    add_bundle(parser, "that computes the touches (default: the one that was running)")
    add_span(parser)


def run(arguments: argparse.Namespace) -> int:
    """Convert, and return 0."""
    kind = arguments.format or FORMATS.get(arguments.out.suffix)
    if kind is None:
        raise UsageError(expected_one_of("the end of --out", arguments.out.suffix, (".npz", ".parquet", "none")))
    check_span(arguments)
    needs.require(f"convert to {kind}", NEEDED_MODULES[kind])
    files.parent(arguments.out) if kind == "rosbag2" else files.writable(arguments.out, OUTPUT_KINDS[kind])
    if arguments.rosbag_version is not None and kind != "rosbag2":
        raise UsageError(f"--rosbag-version is for rosbag2, found {kind}: name a folder with --out")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from eitskin_tools.recording import convert
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
        table = convert.table_of(script, *span, frames)
        {"npz": convert.write_npz, "parquet": convert.write_parquet}[kind](arguments.out, table, script)
        found |= {"frames": len(table.voltages_V), "left_out": table.left_out, "maps": table.maps is not None}
        said = f"{found['frames']} frames, {table.left_out} idle scans of a few drives left out"
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
