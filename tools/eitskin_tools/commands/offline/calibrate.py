"""``eitskin calibrate FILE.npz --out skin.toml``: what this device is, from its reference."""

import argparse
import json
import sys
from pathlib import Path

from eitskin_tools.command_line import files, skins
from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("recording", metavar="FILE", help="the reference as .npz, see docs/calibrate.md")
    parser.add_argument("--out", type=Path, required=True, metavar="SKIN.toml", help="the calibrated description")
    parser.add_argument(
        "--skin",
        metavar="FILE",
        default="lab",
        help="the stated skin, whose uncertainties are the priors: a file, or one of "
        f"{', '.join(files.SKIN.names())} (default: lab)",
    )
    parser.add_argument("--snr-db", type=float, metavar="DB", help="of a frame (default: the least stated)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, report and write the skin."""
    from eitskin_proto.files.writing import write_bytes
    from eitskin_proto.skin.toml import to_toml
    from eitskin_sim.calibration.recording import load_recording
    from eitskin_sim.calibration.report import calibrate, table
    from eitskin_sim.devices.draws import check_outline

    if arguments.snr_db is not None and not 10.0 <= arguments.snr_db <= 120.0:
        raise UsageError(f"--snr-db is {arguments.snr_db:g}, expected 10 to 120")
    files.writable(arguments.out)
    skin = skins.read(arguments.skin)
    check_outline(skin)
    recording = load_recording(files.find(arguments.recording, files.MEASURED), skin)

    def tell(step: int, misfit: float) -> None:
        print(f"eitskin calibrate: step {step}, misfit {misfit:.3g}", file=sys.stderr, flush=True)

    twin, report = calibrate(skin, recording, arguments.snr_db, tell)
    write_bytes(arguments.out, to_toml(twin).encode())
    report["out"] = str(arguments.out)
    if arguments.json:
        print(json.dumps(report))
    else:
        print(table(report))
        print(f"next: eitskin dataset --set free --devices random --skin {arguments.out} --out DIR")
    return 0
