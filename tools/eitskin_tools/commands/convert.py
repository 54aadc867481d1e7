"""``eitskin convert``: a recording as NPZ, Parquet or rosbag2."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files, kinds, needs
from eitskin_tools.command_line.options import add_span, check_span
from eitskin_tools.command_line.parser import expected_one_of
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
    add_span(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Convert, and return 0."""
    kind = arguments.format or FORMATS.get(arguments.out.suffix)
    if kind is None:
        raise UsageError(expected_one_of("the end of --out", arguments.out.suffix, (".npz", ".parquet", "none")))
    check_span(arguments)
    needs.require(f"convert to {kind}", NEEDED_MODULES[kind])
    files.parent(arguments.out) if kind == "rosbag2" else files.writable(arguments.out, OUTPUT_KINDS[kind])
    from eitskin_tools.recording.script import Script

    script = Script(arguments.file)
    if script.ending:
        print(f"eitskin convert: {script.path}{script.ending}", file=sys.stderr)
    found: dict[str, Any] = {"file": str(script.path), "out": str(arguments.out), "format": kind}
    if kind == "rosbag2":
        from eitskin_tools.recording.convert import write_rosbag

        found["messages"] = write_rosbag(arguments.out, script, arguments.from_s, arguments.to_s)
        said = f"{found['messages']} messages"
    else:
        from eitskin_tools.recording import convert as writers
        from eitskin_tools.recording.convert import table_of

        table = table_of(script, arguments.from_s, arguments.to_s)
        {"npz": writers.write_npz, "parquet": writers.write_parquet}[kind](arguments.out, table, script)
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
    if arguments.json:
        print(json.dumps(found))
    else:
        print(f"{arguments.out}: {said}")
    return 0
