"""``eitskin calibrate FILE.npz --out skin.toml``: finds a device's true parameters from its own readings.

With ``--guided --port PORT`` it first records them, step by step, and writes them to FILE.npz.
"""

import argparse
import sys
from pathlib import Path
from shlex import quote
from typing import Any, Final

from eitskin_tools.command_line import files, kinds, options
from eitskin_tools.command_line.options import flag
from eitskin_tools.command_line.parser import whole, within
from eitskin_tools.console.terminal import answer
from eitskin_tools.errors import UsageError

GUIDED: Final[dict[str, Any]] = {
    "port": None, "baud": None, "surface": None, "bends": 3, "presses": 6, "stamp": None, "frames": 40,
}  # fmt: skip
"""Options of ``--guided`` with their defaults."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "recording", metavar="FILE", help="the recorded session (.npz, docs/calibrate.md); with --guided, file to write"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="SKIN.toml", help="the calibrated description")
    parser.add_argument(
        "--skin",
        metavar="FILE",
        default="lab",
        help="the skin as designed; its uncertainties are the priors: a file, or one of "
        f"{', '.join(files.SKIN.names())} (default: lab)",
    )
    parser.add_argument(
        "--snr-db",
        type=within(10.0, 120.0),
        metavar="DB",
        help="signal to noise ratio of a frame (default: the lowest stated)",
    )
    guided = parser.add_argument_group("guided")
    guided.add_argument("--guided", action="store_true", help="record now, with instructions for each step")
    guided.add_argument("--port", help="port of the skin, as for run")
    guided.add_argument("--baud", type=int, help="bits per second of a UART (default 2000000)")
    guided.add_argument(
        "--surface",
        type=Path,
        metavar="CLOUD.npz",
        help="cloud of the sheet during reference and presses, from 'eitskin surface' (default: it lies flat)",
    )
    guided.add_argument("--bends", type=whole(0), metavar="N", help="number of bends (default 3)")
    guided.add_argument("--presses", type=whole(0), metavar="N", help="number of presses (default 6)")
    guided.add_argument(
        "--stamp", metavar="MM", help="size of the stamp in mm: diameter, such as 16, or length x width, such as 20x10"
    )
    guided.add_argument("--frames", type=whole(4), metavar="N", help="frames of each bend and press (default 40)")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, report and write the skin."""
    from eitskin_proto.files.writing import write_bytes
    from eitskin_proto.skin.toml import to_toml
    from eitskin_sim.calibration.parameters import check_contacts
    from eitskin_sim.calibration.printed import table, verdict
    from eitskin_sim.calibration.recording import load_recording
    from eitskin_sim.calibration.report import calibrate
    from eitskin_sim.devices.draws import check_outline

    files.writable(arguments.out, kinds.SKIN)
    skin = options.read_skin(arguments.skin)
    check_outline(skin)
    check_contacts(skin)
    if arguments.guided:
        _record(arguments, skin)
    elif given := [flag(name) for name in GUIDED if getattr(arguments, name) is not None]:
        raise UsageError(f"leave out {', '.join(given)}, or record with --guided")
    recording = load_recording(files.find(arguments.recording, files.CALIBRATION_RECORDING), skin)

    def tell(step: int, misfit: float) -> None:
        print(f"eitskin calibrate: step {step}, misfit {misfit:.3g}", file=sys.stderr, flush=True)

    twin, report = calibrate(skin, recording, arguments.snr_db, tell)
    write_bytes(arguments.out, to_toml(twin).encode())
    report["out"] = str(arguments.out)
    following = _next(twin, arguments.out)
    if not report["explained"]:
        following = "learn touches from presses, without a model: eitskin teach presses.npz --port PORT --out BUNDLE"
    return answer(arguments, report, verdict(report), f"Wrote {arguments.out}. Next: {following}", "", table(report))


def _next(twin: Any, path: Path) -> str:
    """Return the command that makes a calibrated skin's bundle: from the shipped one that fits, or from nothing."""
    from eitskin.model.skin_in_use import knowing, use_skin
    from eitskin_proto.errors import SkinError

    file = quote(str(path))
    try:
        bundle = knowing(twin.touch_kind)
        use_skin(bundle, twin)
    except SkinError:  # none knows its touches, or has its map
        return f"eitskin build {file} --out BUNDLE"
    return f"eitskin adapt-skin {bundle.path.stem} --skin {file} --out BUNDLE"


def _record(arguments: argparse.Namespace, skin: Any) -> None:
    """Lead through a recording, and write it."""
    import numpy as np

    from eitskin.acquisition.device import Device
    from eitskin.acquisition.ports import open_line
    from eitskin.acquisition.serial_port import DEFAULT_BAUD
    from eitskin_proto.files.arrays import save_arrays
    from eitskin_proto.files.writing import replacing
    from eitskin_proto.sensor.ids import PROTOCOL_ID
    from eitskin_proto.sensor.table import N_ROWS
    from eitskin_proto.skin.cloud_file import load_surface
    from eitskin_sim.calibration.stamp import places
    from eitskin_tools.guided import CalibrationGuide, Plan, Terminal, frames_of

    for name, usual in GUIDED.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, usual)
    plan = Plan(
        places_mm=places(skin.outline.size_mm, arguments.presses),
        stamp_mm=_stamp(arguments.stamp),
        bends=arguments.bends,
        frames=arguments.frames,
        lying_mm=_lying(arguments.surface, skin),
    )
    if not arguments.port:
        raise UsageError("--guided needs --port, of a skin or of 'eitskin virtual-skin'")
    if arguments.json:
        raise UsageError(
            "--guided prints its instructions on standard output: leave --json out, then calibrate FILE again with it"
        )
    files.writable(Path(arguments.recording), kinds.GUIDED)
    ids = {"protocol_id": PROTOCOL_ID, "grid_id": skin.grid_id, "skin_digest": skin.digest}

    talk = Terminal()
    line = open_line(arguments.port, arguments.baud or DEFAULT_BAUD)
    try:
        device = Device(line, skin)
        if device.hello.rows == N_ROWS:
            talk.say(f"the device scans {N_ROWS} rows: a configuration of 208 would find more about its front end")
        device.start()
        guide = CalibrationGuide(
            plan, frames_of(device), talk, lambda name: np.array(load_surface(name, skin).cloud_mm)
        )
        arrays = guide.run()
        device.stop()
    finally:
        talk.end()
        line.close()
    with replacing(arguments.recording) as file:  # before anything else can go wrong
        save_arrays(file, {**arrays, **ids})


def _lying(path: Path | None, skin: Any) -> Any:
    """Return the scan (3, rows, columns) of the sheet in its shape for the reference; None if it is flat."""
    if path is None:
        return None
    from eitskin_proto.skin.cloud_file import load_surface
    from eitskin_proto.skin.sheet_cloud import check_sheet

    try:
        return check_sheet(load_surface(path, skin).cloud_mm, skin)[0]
    except ValueError as error:
        raise UsageError(f"--surface {path}: {error}") from error


def _stamp(text: str | None) -> tuple[float, ...]:
    if text is None:
        return ()
    try:
        found = tuple(float(one) for one in text.lower().split("x"))
    except ValueError:
        found = ()
    if len(found) not in (1, 2) or not all(3.0 <= one <= 60.0 for one in found):
        raise UsageError(
            f"--stamp is {text!r}, expected a diameter such as 16, or length x width such as 20x10, each 3 to 60 mm"
        )
    return found
