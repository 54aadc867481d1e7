"""``eitskin doctor``: what is there, what is wrong with it, and what to do about it."""

import argparse
import json
from pathlib import Path
from typing import Any


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--port", help="greet the device on this port (a path, or usb:SERIAL) as well")
    parser.add_argument("--baud", type=int, help="bits per second on a real UART (default 2000000)")
    parser.add_argument("--make-curve-keys", type=Path, metavar="DIR", help="make CURVE keys for TCP, then exit")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Print what was found and return 0; a port that was named and does not answer is a failure."""
    if arguments.make_curve_keys is not None:
        return _make_keys(arguments)
    from eitskin import doctor

    found = doctor.examine()
    if arguments.port:
        from eitskin.serial_port import DEFAULT_BAUD

        baud = arguments.baud or DEFAULT_BAUD
        device = doctor.greet(arguments.port, baud)
        found["problems"] += device.pop("problems")
        found["device"] = device
        found["configuration"] = _configuration(arguments.port, baud)
    if arguments.json:
        print(json.dumps(found))
    else:
        _print(found)
    return 0


def _configuration(port: str, baud: int) -> dict[str, Any]:
    """Return the fields of what the device runs, and the name of what a rollback would return to."""
    from dataclasses import asdict

    from eitskin.lines import open_line
    from eitskin_tools.flash.exchange import Exchange
    from eitskin_tools.flash.procedure import show

    line = open_line(port, baud)
    try:
        shown = show(Exchange(line))
    finally:
        line.close()
    other = shown.other.configuration.name if shown.other else None
    return {**asdict(shown.active.configuration), "rolls_back_to": other}


def _make_keys(arguments: argparse.Namespace) -> int:
    from eitskin.curve import make_keys

    made = [str(path) for path in make_keys(arguments.make_curve_keys)]
    print(json.dumps({"files": made}) if arguments.json else "\n".join(made))
    return 0


def _print(found: dict[str, Any]) -> None:
    for port in found["ports"]:
        print(f"port     {port['port']}  {port['description']}  {port['id']}  {port['state']}")
    for device in found["usb"]:
        print(f"usb      {device['port']}  {device['id']}  {device['node']}  {device['state']}")
    for bundle in found["bundles"]:
        print(f"bundle   {bundle['path']}  {bundle['state']}")
    for line in found["limits"]:
        print(f"limit    {line}")
    for section in ("device", "configuration"):
        for name, value in found.get(section, {}).items():
            print(f"{section if section == 'device' else 'config':<8} {name} {value}")
    for problem in found["problems"]:
        print(f"to do    {problem}")
