"""``eitskin doctor``: what is there, what is wrong with it, and what to do about it."""

import argparse
import json
from pathlib import Path
from typing import Any


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--port", help="greet the device on this port as well")
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

        found["device"] = doctor.greet(arguments.port, arguments.baud or DEFAULT_BAUD)
    if arguments.json:
        print(json.dumps(found))
    else:
        _print(found)
    return 0


def _make_keys(arguments: argparse.Namespace) -> int:
    from eitskin.curve import make_keys

    made = [str(path) for path in make_keys(arguments.make_curve_keys)]
    print(json.dumps({"files": made}) if arguments.json else "\n".join(made))
    return 0


def _print(found: dict[str, Any]) -> None:
    for port in found["ports"]:
        print(f"port     {port['port']}  {port['description']}  {port['id']}  {port['state']}")
    if not found["ports"]:
        print("port     none; plug the skin in, or start a virtual one with 'eitskin sim'")
    for bundle in found["bundles"]:
        print(f"bundle   {bundle['path']}  {bundle['state']}")
    for line in found["limits"]:
        print(f"limit    {line}")
    if "device" in found:
        print("device   " + ", ".join(f"{name} {value}" for name, value in found["device"].items()))
    for problem in found["problems"]:
        print(f"to do    {problem}")
