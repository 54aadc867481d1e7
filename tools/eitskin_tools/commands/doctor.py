"""``eitskin doctor``: lists ports, bundles and limits, and says how to fix each problem."""

import argparse
import sys
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files, options
from eitskin_tools.command_line.options import flag
from eitskin_tools.console.terminal import answer, in_words
from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--port", help="also test the device on this port (a path, or usb:SERIAL)")
    parser.add_argument("--baud", type=int, help="bits per second of a UART (default 2000000)")
    parser.add_argument("--make-curve-keys", type=Path, metavar="DIR", help="make CURVE keys for TCP, then exit")
    parser.add_argument(
        "--electrodes", action="store_true", help="check all 16 electrodes, on --port or in --recorded frames"
    )
    parser.add_argument(
        "--touch",
        action="store_true",
        help="measure by one press whether touches raise or lower conductance, on --port or in --recorded frames "
        "(.npy: untouched in the first half, pressed in the second)",
    )
    parser.add_argument("--skin", metavar="FILE", help="--touch: description of the sheet (default: lab)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="--touch: write --skin with the answer to this file")
    parser.add_argument(
        "--recorded", type=Path, metavar="FILE", help="recorded frames: .npy of (n, 104) V, or the end of a .mcap"
    )
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="measuring time (default 2)")
    parser.add_argument("--reference", type=Path, metavar="FILE", help="captured reference (default: the model's)")
    options.add_bundle(parser, "to judge the electrodes by (default: free)")


def run(arguments: argparse.Namespace) -> int:
    """Print the findings and return 0; a named port that does not answer is a failure."""
    if arguments.make_curve_keys is not None:
        return _make_keys(arguments)
    from eitskin.diagnostics import doctor

    if arguments.electrodes and arguments.touch:
        raise UsageError("use one of --electrodes and --touch, not both at once")
    if arguments.touch:
        return _touch(arguments)
    for name in ("skin", "out"):
        if getattr(arguments, name) is not None:
            raise UsageError(f"{flag(name)} needs --touch beside it")
    if arguments.electrodes:
        return _electrodes(arguments)
    for name in ("recorded", "reference", "bundle"):
        if getattr(arguments, name) is not None:
            raise UsageError(f"{flag(name)} needs --electrodes beside it")
    found = doctor.examine()
    if arguments.port:
        from eitskin.acquisition.serial_port import DEFAULT_BAUD

        device = doctor.greet(arguments.port, arguments.baud or DEFAULT_BAUD)
        found["verdict"] = device.pop("verdict")
        found["problems"] += device.pop("problems")
        found["device"] = device
    return answer(arguments, found, *_lines(found))


def _electrodes(arguments: argparse.Namespace) -> int:
    """Print the sixteen electrodes and return 0."""
    from eitskin.diagnostics import electrode_checkup
    from eitskin.errors import BundleError
    from eitskin.health.imputation import MISSING, Consistency
    from eitskin.model.bundle import load_bundle
    from eitskin.reference.captured import load

    _check_source(arguments, "--electrodes")
    bundle = load_bundle(arguments.bundle)
    arrays = bundle.consistency_arrays()
    if arrays is None:
        raise BundleError(f"{bundle.path}: finding failed electrodes is {MISSING}")
    reference = None if arguments.reference is None else load(arguments.reference, bundle.skin)
    if arguments.recorded is not None and arguments.recorded.suffix == ".mcap":
        recording, own = _of_recording(arguments, bundle)
        reference = reference or own
    else:
        recording = _frames(arguments)
    found = electrode_checkup.check_up(recording, Consistency.of(arrays), reference)
    return answer(arguments, found, *electrode_checkup.lines(found))


def _touch(arguments: argparse.Namespace) -> int:
    """Print which way a press changes conductance, and return 0."""
    from dataclasses import replace

    from eitskin_proto.files.writing import write_bytes
    from eitskin_proto.skin.toml import to_toml
    from eitskin_sim.calibration.way import press_way
    from eitskin_tools.command_line import kinds

    _check_source(arguments, "--touch")
    if arguments.out is not None:
        if arguments.skin is None:
            raise UsageError("--out needs --skin FILE, the description to write with the answer")
        files.writable(arguments.out, kinds.SKIN)
    skin = options.read_skin(arguments.skin or "lab")
    found = press_way(*_press(arguments), skin)
    x, y = found.xy_mm
    following, out = f'Write into the skin\'s file, under [touches]:  kind = "{found.kind}"', None
    if arguments.out is not None:
        stated = replace(skin, touches=replace(skin.touches, kind=found.kind))
        write_bytes(arguments.out, to_toml(stated).encode())
        following, out = f"Wrote {arguments.out}.", str(arguments.out)
    report = {"kind": found.kind, "log_ratio": found.log_ratio, "xy_mm": [x, y], "out": out}
    said = f"Touches {found.kind} conductance: the press was felt near ({x:.0f}, {y:.0f}) mm."
    return answer(arguments, report, said, following)


def _press(arguments: argparse.Namespace) -> tuple[Any, Any]:
    """Return the voltages (n, 104) V of untouched frames and of pressed ones."""
    if arguments.recorded is not None:
        if arguments.recorded.suffix == ".mcap":
            raise UsageError("--touch takes recorded frames as .npy, untouched in the first half; found a recording")
        volts = _frames(arguments).voltages
        return volts[: len(volts) // 2], volts[len(volts) // 2 :]
    parts = []
    for step in ("Leave the sheet untouched", "Press firmly, well inside the sheet, and hold"):
        print(f"{step}; then press Enter.", file=sys.stderr, flush=True)
        if not sys.stdin.readline():
            raise UsageError("--touch on a port needs someone who presses: standard input has ended")
        parts.append(_frames(arguments).voltages)
    return parts[0], parts[1]


def _check_source(arguments: argparse.Namespace, what: str) -> None:
    if (arguments.port is None) == (arguments.recorded is None):
        raise UsageError(f"{what} needs either --port PORT or --recorded FILE")


def _frames(arguments: argparse.Namespace) -> Any:
    """Return the frames of a port, or of an .npy file."""
    from eitskin.acquisition.serial_port import DEFAULT_BAUD
    from eitskin.diagnostics import electrode_checkup

    if arguments.recorded is None:
        return electrode_checkup.record(arguments.port, arguments.seconds, arguments.baud or DEFAULT_BAUD)
    return electrode_checkup.load_recording(files.find(arguments.recorded, files.RECORDING))


def _of_recording(arguments: argparse.Namespace, bundle: Any) -> tuple[Any, Any]:
    """Return the last seconds of a recording of a bundle's skin, and the reference that held then."""
    from eitskin.diagnostics.electrode_checkup import Recording
    from eitskin_tools.command_line.needs import RECORDINGS, require

    require("a recording", RECORDINGS)
    from eitskin.errors import BadReference
    from eitskin.health.electrodes import WINDOW
    from eitskin_proto.wire.volts import step_of
    from eitskin_tools.recording.convert import table_of
    from eitskin_tools.recording.script import Script, for_skin, reference_of

    script = Script(files.find(arguments.recorded, files.RECORDING))
    if script.ending:
        print(f"eitskin doctor: {script.path}{script.ending}", file=sys.stderr)
    for_skin(bundle, script)
    begin_s = max(script.seconds - arguments.seconds, 0.0)
    found = table_of(script, begin_s)
    if len(found.voltages_V) < WINDOW:
        raise BadReference(
            f"{script.path}: found {len(found.voltages_V)} frames, expected at least {WINDOW}; raise --seconds"
        )
    held = [step.reference for step in script.steps(begin_s) if step.reference is not None]
    reference = reference_of(script, held[-1] if held else script.reference())
    return Recording(found.voltages_V, None, step_of(script.hello)), reference


def _make_keys(arguments: argparse.Namespace) -> int:
    from eitskin.messaging.curve_keys import make_keys

    made = [str(path) for path in make_keys(arguments.make_curve_keys)]
    return answer(arguments, {"files": made}, *made)


def _lines(found: dict[str, Any]) -> list[str]:
    return [
        found["verdict"],
        *(f"port     {port['port']}  {port['description']}  {port['id']}  {port['state']}" for port in found["ports"]),
        *(f"usb      {one['port']}  {one['id']}  {one['node']}  {one['state']}" for one in found["usb"]),
        *(f"bundle   {bundle['path']}  {bundle['state']}" for bundle in found["bundles"]),
        *(f"runtime  publishing on {endpoint}" for endpoint in found["runtimes"]),
        *(f"limit    {line}" for line in found["limits"]),
        *(f"device   {name} {in_words(value)}" for name, value in found.get("device", {}).items()),
        *(f"to do    {problem}" for problem in found["problems"]),
    ]
