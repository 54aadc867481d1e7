"""``eitskin teach FILE.npz ... --out B.eitskin``: a bundle that finds touches as recorded presses have shown them.

With ``--port`` it first leads through the presses and writes them to FILE.npz; with ``--recording`` it takes them out
of a recording.
"""

import argparse
import os
import sys
from pathlib import Path
from typing import Any, Final

from eitskin_tools.command_line import files, kinds, options
from eitskin_tools.command_line.options import flag
from eitskin_tools.command_line.parser import whole, within
from eitskin_tools.console.terminal import answer, note
from eitskin_tools.errors import UsageError

NEEDS: Final = {
    "baud": ("port",), "presses": ("port", "grid"), "page": ("port",), "places": ("recording",),
    "frames": ("port", "recording"),
}  # fmt: skip
"""Options that do something only with one of others."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="presses at known places (.npz), a file for each shape of the sheet; file to write, if recorded now",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="B.eitskin", help="the bundle to write")
    parser.add_argument("--skin", metavar="SKIN.toml", help="description of the sheet (default: its size alone)")
    parser.add_argument(
        "--false-alarms", type=within(1e-4, 0.5), default=0.01, metavar="SHARE",
        help="share of untouched frames that may look touched (default: 0.01)",
    )  # fmt: skip
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="draw where presses are placed well and badly")
    guided = parser.add_argument_group("record the presses")
    guided.add_argument("--port", help="lead through presses now: serial port, usb:SERIAL or NAME:REST of the device")
    guided.add_argument("--baud", type=int, metavar="N", help="bits per second of a UART (default: 2000000)")
    guided.add_argument("--presses", type=whole(6), metavar="N", help="places of the grid, about (default: 60)")
    guided.add_argument(
        "--grid", type=Path, metavar="FILE.svg", help="write the grid, to be printed at 100 %%, and stop"
    )
    guided.add_argument("--page", type=int, metavar="PORT", help="show the next place on a page at this port")
    guided.add_argument("--recording", type=Path, metavar="FILE.mcap", help="take the presses out of a recording")
    guided.add_argument("--places", type=Path, metavar="LIST", help="--recording: x and y of each press, a line each")
    guided.add_argument("--frames", type=whole(2), metavar="N", help="frames of each press and before it (default: 20)")


def run(arguments: argparse.Namespace) -> int:
    """Teach, write the bundle and report."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is first imported, below
    files.writable(arguments.out, kinds.BUNDLE)
    if arguments.picture is not None:
        files.picture(arguments.picture)
    from eitskin_tools.console.terminal import StatusLine
    from eitskin_tools.teach import card, physics
    from eitskin_tools.teach.presses import load_presses
    from eitskin_tools.teach.taught_bundle import write_taught
    from eitskin_tools.teach.teaching import fitting, teach_shapes

    skin = None if arguments.skin is None else options.read_skin(arguments.skin)
    _record(arguments, options.chosen_skin(arguments))
    if arguments.grid is not None:
        return _write_grid(arguments, options.chosen_skin(arguments))
    shapes = {one.stem: load_presses(files.find(one, files.PRESSES)) for one in arguments.files}
    if len(shapes) < len(arguments.files):
        raise UsageError("two files have the same name, expected one of each shape of the sheet: rename one")
    for name, presses in shapes.items():
        if wrong := physics.wiring_of(presses, fitting(presses, skin)):
            note(f"eitskin teach: warning: {name}: {wrong}")
    line = StatusLine(sys.stderr)
    taught = teach_shapes(shapes, skin, arguments.false_alarms, line.show)
    line.end()
    bundle = write_taught(arguments.out, taught, presses, tikhonov=skin is not None)
    reports = {name: one.report for name, one in taught.items()}
    if arguments.picture is not None:
        card.draw(arguments.picture, taught)
    if presses.logarithmic and presses.is_change and presses.table.electrodes is None:
        note("eitskin teach: no run can check the order of its rows: the file has no table, nor voltages")
    after = "Wrote {}. Next: eitskin run --port PORT --bundle {}"
    if not presses.logarithmic:
        after = "Wrote {}. Its changes have no known unit, so it works with 'eitskin evaluate --measured' alone ({})."
    found = {"out": str(arguments.out), "bundle": bundle, **card.of_shapes(reports)}
    return answer(arguments, found, card.verdict(reports), after.format(arguments.out, arguments.out))


def _record(arguments: argparse.Namespace, skin: Any) -> None:
    """Write the file of presses, if it is recorded now or taken out of a recording."""
    given = [name for name in ("port", "recording", "grid") if getattr(arguments, name) is not None]
    for name, needs in NEEDS.items():
        if getattr(arguments, name) is not None and not set(needs) & set(given):
            raise UsageError(f"{flag(name)} does nothing without {' or '.join(map(flag, needs))}: leave it out")
    if not given:
        return
    if len(arguments.files) > 1:
        raise UsageError(f"{flag(given[0])} is for one file: teach several shapes by the files of each")
    if len(given) > 1:
        raise UsageError(f"{' and '.join(map(flag, given))} do not go together: leave one out")
    if (arguments.recording is None) != (arguments.places is None):
        raise UsageError("--recording needs --places, a list of x and y of each press in mm")
    if arguments.grid is not None:
        return
    files.writable(arguments.files[0], kinds.PRESSES)
    from eitskin.acquisition.serial_port import DEFAULT_BAUD
    from eitskin_tools.teach.live import lead_through, presses_of_recording

    frames = arguments.frames or 20
    if arguments.recording is not None:
        presses_of_recording(arguments.recording, arguments.places, skin, frames, arguments.files[0])
        return
    if arguments.json:
        raise UsageError(
            "--port prints its instructions on standard output: leave --json out, then teach FILE again with it"
        )
    baud = arguments.baud or DEFAULT_BAUD
    lead_through(
        arguments.files[0],
        skin,
        arguments.port,
        baud,
        presses=arguments.presses or 60,
        frames=frames,
        page=arguments.page,
    )


def _write_grid(arguments: argparse.Namespace, skin: Any) -> int:
    from eitskin_proto.files.writing import write_bytes
    from eitskin_tools.teach.places import draw_grid, grid_places

    length, width = skin.outline.size_mm
    places = grid_places((length, width), skin.outline.kind, arguments.presses or 60)
    words = [str(arguments.files[0]), "--out", str(arguments.out)]
    words += [] if arguments.skin is None else ["--skin", str(arguments.skin)]
    write_bytes(arguments.grid, draw_grid((length, width), skin.outline.kind, places).encode())
    print(
        f"Wrote {arguments.grid}: {len(places)} places on {length:g} x {width:g} mm. Print it at 100 % and lay it "
        f"under the sheet. Next: {' '.join(['eitskin teach', *words])} --port PORT"
    )
    return 0
