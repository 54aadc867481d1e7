"""``eitskin convert``: a recording as NPZ, Parquet, CSV, rosbag2 or a LeRobot data set."""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from eitskin_proto.errors import SkinError
from eitskin_tools.command_line import files, kinds, needs
from eitskin_tools.command_line.options import add_bundle, add_span, check_span
from eitskin_tools.command_line.parser import expected_one_of, positive
from eitskin_tools.console.terminal import answer
from eitskin_tools.errors import UsageError

FORMATS = {".npz": "npz", ".parquet": "parquet", ".csv": "csv", "": "rosbag2"}
"""By the end of the name; a folder has none."""

OUTPUT_KINDS = {"npz": kinds.CONVERTED, "parquet": kinds.PARQUET, "csv": kinds.CSV}

FOLDERS = ("rosbag2", "lerobot")
"""Formats that are written as a folder."""

NEEDED_MODULES = {"npz": (), "parquet": ("pyarrow",), "csv": (), "rosbag2": ("rosbags",), "lerobot": ()}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "file", type=Path, nargs="+", metavar="FILE.mcap", help="made by 'eitskin record'; several for --lerobot alone"
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="OUT", help="X.npz, .parquet or .csv, or a new folder"
    )
    parser.add_argument("--format", choices=tuple(NEEDED_MODULES), help="default: from the ending of OUT")
    parser.add_argument(
        "--lerobot", action="store_const", dest="format", const="lerobot", help="a data set of LeRobot, at --rate"
    )
    parser.add_argument("--task", default="", metavar="TEXT", help="with --lerobot: what the robot does")
    parser.add_argument(
        "--rosbag-version", type=int, choices=(8, 9), metavar="N", help="8 for ROS 2 Humble, 9 for Jazzy (default 9)"
    )
    parser.add_argument("--rate", type=positive(1000), metavar="HZ", help="rows a second (default: a row a frame)")
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
    _check(arguments, kind)
    needs.require(f"convert to {kind}", NEEDED_MODULES[kind])
    files.parent(arguments.out) if kind in FOLDERS else files.writable(arguments.out, OUTPUT_KINDS[kind])
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if kind == "lerobot":
        return _write_lerobot(arguments)
    from eitskin_tools.recording import convert
    from eitskin_tools.recording.script import Script

    script = Script(arguments.file[0])
    frames = _frames(script, arguments.bundle)
    found: dict[str, Any] = {"file": str(script.path), "out": str(arguments.out), "format": kind}
    span = arguments.from_s, arguments.to_s
    if kind == "rosbag2":
        version: Any = arguments.rosbag_version or 9
        found["messages"] = convert.write_rosbag(arguments.out, script, *span, frames=frames, version=version)
        said = f"{found['messages']} messages"
    else:
        table, times = _rows(arguments, script, frames)
        write = {"npz": convert.write_npz, "parquet": convert.write_parquet, "csv": convert.write_csv}[kind]
        write(arguments.out, table, script)
        found |= {"frames": len(table.voltages_V), "left_out": table.left_out, "maps": table.maps is not None}
        said = f"{found['frames']} frames, {table.left_out} idle scans of a few drives left out"
        if times is not None:
            found["without_frame"] = times - found["frames"]
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


def _check(arguments: argparse.Namespace, kind: str) -> None:
    """Refuse options that another format has."""
    if arguments.rosbag_version is not None and kind != "rosbag2":
        raise UsageError(f"--rosbag-version is for rosbag2, found {kind}: name a folder with --out")
    if (arguments.rate or arguments.clock) and kind == "rosbag2":
        raise UsageError("--rate and --clock do nothing with rosbag2, which has each frame: leave them out")
    if kind == "lerobot" and not (arguments.rate and arguments.rate.is_integer()):
        raise UsageError("--lerobot needs --rate HZ, a whole number of frames a second")
    if kind != "lerobot" and (arguments.task or len(arguments.file) > 1):
        raise UsageError("--task and several recordings are for --lerobot: leave them out")


def _rows(arguments: argparse.Namespace, script: Any, frames: Any, **options: Any) -> tuple[Any, int | None]:
    """Return the table of a recording, and how many times were named for its rows; None for none."""
    from eitskin_tools.recording.convert import table_of
    from eitskin_tools.recording.resample import clock_ns, regular_ns, resampled

    times_ns = None if arguments.clock is None else clock_ns(arguments.clock, arguments.rate)
    table = table_of(script, arguments.from_s, arguments.to_s, frames, **options)
    if times_ns is None and arguments.rate is None:
        return table, None
    if times_ns is None:
        times_ns = regular_ns(table, arguments.rate)
    return resampled(table, times_ns), len(times_ns)


def _write_lerobot(arguments: argparse.Namespace) -> int:
    """Write each recording as an episode of a data set, and return 0."""
    from eitskin_tools.recording.frames import RecordedFrames
    from eitskin_tools.recording.layout import RecordingError
    from eitskin_tools.recording.script import Script, bundle_of

    try:
        from lerobot_camera_eitskin.dataset import write_dataset
    except ImportError as error:
        raise SkinError(
            f"--lerobot needs LeRobot and the plug-in of tools/lerobot ({error}): install both as docs/lerobot.md says"
        ) from error
    if arguments.out.exists():
        raise RecordingError(f"{arguments.out} already exists: name another folder, or remove it")
    tables = list[Any]()
    for path in arguments.file:
        script = Script(path)
        frames = RecordedFrames(script, bundle_of(script, arguments.bundle))
        table, times = _rows(arguments, script, frames, compute_maps=True)
        if (count := len(table.maps)) < max(times or 0, 2):  # LeRobot cannot join one frame's statistics with others'
            raise RecordingError(
                f"{path}: {count} of {times} times have a published frame, but an episode has at least 2 frames and no "
                "gap: choose a part with --from and --to, or other times"
            )
        tables.append(table)
    episodes = ((zip(table.maps, table.touches_by_row(), strict=True)) for table in tables)
    write_dataset(arguments.out, episodes, tables[0].maps.shape[1:], int(arguments.rate), arguments.task)
    count = sum(len(table.maps) for table in tables)
    found = {"files": [str(path) for path in arguments.file], "out": str(arguments.out), "format": "lerobot",
             "episodes": len(tables), "frames": count}  # fmt: skip
    return answer(arguments, found, f"{arguments.out}: {len(tables)} episodes, {count} frames")


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
