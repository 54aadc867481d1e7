"""Looks at what the runtime depends on, and says what to do about each problem; changes nothing."""

import os
import resource
from pathlib import Path
from typing import Any, Final

from serial.tools import list_ports

from eitskin.bundle import LABELS, default_path, load_bundle
from eitskin.device import Device
from eitskin.endpoints import runtime_folder
from eitskin.errors import SkinError
from eitskin.serial_port import SerialPort

SLOW_LATENCY_MS: Final = 1
"""An FTDI adapter holds bytes back for up to this long at best; 16 ms is what it comes with."""


def examine() -> dict[str, Any]:
    """Return ports, bundles, limits and problems as plain values."""
    problems: list[str] = []
    ports = [_port(info, problems) for info in sorted(list_ports.comports())]
    bundles = [_bundle(labels, problems) for labels in LABELS]
    try:
        folder = str(runtime_folder())
    except SkinError as error:
        folder = "unusable"
        problems.append(str(error))
    return {
        "ports": ports,
        "bundles": bundles,
        "limits": [f"endpoints in {folder}", _limit("real-time priority", resource.RLIMIT_RTPRIO),
                   _limit("locked memory", resource.RLIMIT_MEMLOCK), _limit("open files", resource.RLIMIT_NOFILE)],
        "problems": problems,
    }  # fmt: skip


def greet(port: str, baud: int) -> dict[str, Any]:
    """Return what the device on a port says about itself.

    Raises:
        TransportError: The port is missing, busy, denied or lost.
        HandshakeError: The device does not answer, or measures in a way that cannot be used.
        MismatchError: It was built for another protocol_id or grid_id.
    """
    transport = SerialPort(port, baud)
    try:
        device = Device(transport)
        hello = device.hello
        return {
            "serial_number": hello.serial_number,
            "firmware": ".".join(map(str, hello.firmware_version)),
            "protocol": f"{hello.protocol_major}.{hello.protocol_minor}",
            "configuration": device.configuration,
            "generation": hello.generation,
            "rate_hz": hello.rate_mHz / 1000,
            "rows": hello.rows,
            "sample_bytes": hello.sample_bytes,
            "uptime_s": hello.uptime_ms / 1000,
        }
    finally:
        transport.close()


def _port(info: Any, problems: list[str]) -> dict[str, Any]:
    usb = f"{info.vid:04x}:{info.pid:04x} {info.serial_number or ''}".strip() if info.vid is not None else ""
    state = "usable"
    if not os.access(info.device, os.R_OK | os.W_OK):
        state = "no permission"
        problems.append(f"{info.device}: run 'sudo usermod -aG dialout $USER', then log in again")
    timer = Path("/sys/bus/usb-serial/devices", Path(info.device).name, "latency_timer")
    if timer.exists():
        waits_ms = int(timer.read_text(encoding="ascii").strip() or 0)
        state += f", latency timer {waits_ms} ms"
        if waits_ms > SLOW_LATENCY_MS:
            problems.append(
                f"{info.device}: bytes wait up to {waits_ms} ms; run 'echo 1 | sudo tee {timer}', or add a udev rule "
                'with ATTR{latency_timer}="1"'
            )
    return {"port": info.device, "description": info.description, "id": usb, "state": state}


def _bundle(labels: str, problems: list[str]) -> dict[str, Any]:
    path = default_path(labels)
    try:
        found = load_bundle(path)
    except SkinError as error:
        problems.append(str(error))
        return {"path": str(path), "labels": labels, "id": "", "state": "unusable"}
    return {"path": str(path), "labels": labels, "id": found.id, "state": f"intact, {labels} labels, {found.id}"}


def _limit(name: str, which: int) -> str:
    soft, hard = resource.getrlimit(which)
    words = ["unlimited" if value == resource.RLIM_INFINITY else str(value) for value in (soft, hard)]
    return f"{name}: {words[0]} of at most {words[1]}"
