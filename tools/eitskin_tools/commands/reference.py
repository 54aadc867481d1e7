"""``eitskin reference``: capture the one pre-deformation reference of a skin, or show a captured one.

A reference of a bent, touched or moving sheet is refused. It is compared with the bundle's flat sheet, and with an
older reference of the same device: that of ``--against``, or the file that ``--out`` replaces. With a scan of the sheet
(``--surface``) the reference includes the scan and counts as that of the flat sheet.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files, kinds, options
from eitskin_tools.command_line.parser import whole
from eitskin_tools.console.terminal import answer, note
from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--port", help="capture: port of the skin, flat and untouched, as for run")
    what.add_argument("--show", type=Path, metavar="FILE", help="show a captured reference")
    parser.add_argument("--out", type=Path, metavar="FILE", help="capture: file to write")
    options.add_reconnect(parser)
    parser.add_argument(
        "--frames", type=whole(2, 10_000), default=100, metavar="N", help="capture: number of frames (default 100)"
    )
    parser.add_argument("--baud", type=int, help="bits per second of a UART (default 2000000)")
    options.add_bundle(
        parser,
        "to check it against (default: the shipped one of area labels and of the skin's touches)",
    )
    parser.add_argument("--skin", type=Path, metavar="FILE", help="description of the sheet, which the bundle must fit")
    parser.add_argument(
        "--against",
        type=Path,
        metavar="FILE",
        help="older reference to compare it with (default: the one that --out replaces)",
    )
    parser.add_argument(
        "--surface", metavar="CLOUD", help="cloud of the sheet now, from 'eitskin surface --predict' (default: flat)"
    )
    parser.add_argument("--force", action="store_true", help="store it even if the sheet seems bent, touched or moving")


def run(arguments: argparse.Namespace) -> int:
    """Capture or show a reference and return 0."""
    from eitskin.reference import captured as references

    if arguments.show is not None:
        found = references.load(arguments.show)
    else:
        if arguments.out is None:
            raise UsageError("--port captures a reference; name the file that it goes to with --out")
        files.writable(arguments.out, kinds.REFERENCE)
        found = _capture(arguments)
        references.save(found, arguments.out)
    return answer(arguments, _fields(found), *found.report())


def _capture(arguments: argparse.Namespace) -> Any:
    from eitskin.acquisition.capture import capture
    from eitskin.acquisition.serial_port import DEFAULT_BAUD
    from eitskin.model.skin_in_use import bundle_and_skin
    from eitskin.reference.judged import reference_checks
    from eitskin.reference.plausible import scan_of
    from eitskin_proto.skin.cloud_file import load_surface

    bundle, skin = bundle_and_skin(arguments.bundle, arguments.skin)
    checks = reference_checks(bundle, _older(arguments, skin))
    scan = None
    if arguments.surface is not None:
        scan = scan_of(load_surface(arguments.surface, skin), skin)
    lies = "lie flat" if scan is None else "lie as scanned"
    print(f"eitskin reference: capturing now; the sheet must {lies}, untouched", file=sys.stderr)
    return capture(
        arguments.port,
        arguments.frames,
        arguments.baud or DEFAULT_BAUD,
        checks=checks,
        force=arguments.force,
        skin=skin,
        scan=scan,
        reconnect_s=arguments.reconnect,
    )


def _older(arguments: argparse.Namespace, skin: Any) -> Any:
    """Return the reference to compare with: the named one, or the one about to be replaced."""
    from eitskin.reference import captured as references
    from eitskin_proto.errors import SkinError

    if arguments.against is not None:
        return references.load(arguments.against, skin)
    if not arguments.out.exists():
        return None
    try:
        return references.load(arguments.out, skin)
    except SkinError as error:
        note(f"eitskin reference: replacing {arguments.out} without comparing: {error}")
        return None


def _fields(found: Any) -> dict[str, object]:
    return {
        "serial_number": found.serial_number,
        "configuration": f"{found.configuration_name}/{found.configuration_digest:08x}",
        "skin_digest": found.skin_digest,
        "captured_utc": found.captured_utc,
        **found.answer(),
        "scanned": found.scan is not None,
        "voltages_V": found.voltages_V.tolist(),
        "spread_V": found.spread_V.tolist(),
    }
