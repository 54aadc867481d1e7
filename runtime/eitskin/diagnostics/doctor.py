"""Examines what the runtime depends on and says how to fix each problem; changes nothing.

``examine`` needs no device: it looks at ports, USB devices, permissions, latency timers, bundles and limits. ``greet``
opens one port and asks the device for its name, its configuration and how fast it answers. Both return plain values,
a verdict, and a list of problems with their fixes.
"""

import os
import resource
from pathlib import Path
from typing import Any, Final

from eitskin.acquisition.device import Device
from eitskin.acquisition.ports import open_line, serial_ports
from eitskin.acquisition.serial_port import DEFAULT_BAUD
from eitskin.errors import SkinError
from eitskin.messaging.endpoints import FRAMES, runtime_folder
from eitskin.messaging.reachability import running
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.manifest import LABELS
from eitskin_proto.wire.codes import HelloFlag
from eitskin_proto.wire.messages import Hello

SLOW_LATENCY_MS: Final = 1
"""An FTDI adapter holds bytes back for up to this long at best; 16 ms is what it comes with."""

SLOW_ANSWER_MS: Final = 5.0
"""A round trip of this length at best has been held back somewhere: USB frames take 1 ms, a UART 0.2 ms."""

ADAPTERS: Final = Path("/sys/bus/usb-serial/devices")
"""Where the kernel shows the latency timers of serial adapters."""

UART_TYPES: Final = Path("/sys/class/tty")
"""Where the kernel shows the type of a port's UART; 0 is a port without hardware behind it."""

SYSTEM_RULES: Final = (Path("/etc/udev/rules.d"), Path("/usr/lib/udev/rules.d"), Path("/lib/udev/rules.d"))


def examine() -> dict[str, Any]:
    """Return a verdict, ports, USB devices, bundles, running runtimes, limits and problems as plain values."""
    problems: list[str] = []
    ports = [_port(info, problems) for info in sorted(serial_ports())]
    usb = _usb(problems)
    bundles = [_bundle(labels, path, problems) for labels, path in _shipped()]
    try:
        folder = str(runtime_folder())
    except SkinError as error:
        folder = "unusable"
        problems.append(str(error))
    return {
        "verdict": _verdict(ports, usb),
        "ports": ports,
        "usb": usb,
        "bundles": bundles,
        "runtimes": list(running(FRAMES)),
        "limits": [f"endpoints in {folder}", _limit("real-time priority", resource.RLIMIT_RTPRIO),
                   _limit("locked memory", resource.RLIMIT_MEMLOCK), _limit("open files", resource.RLIMIT_NOFILE)],
        "problems": problems,
    }  # fmt: skip


def _verdict(ports: list[dict[str, Any]], usb: list[dict[str, Any]]) -> str:
    """Return whether there is a skin that this user can open, in a sentence or two."""
    plugged = [one for one in (*ports, *usb) if one["id"]]
    ready = [str(one["port"]) for one in plugged if not one["state"].startswith("no permission")]
    if ready:
        number = "one USB device" if len(ready) == 1 else f"{len(ready)} USB devices"
        return f"Ready: {number}, {', '.join(ready)}. Test it: eitskin doctor --port {ready[0]}"
    if plugged:
        return f"Not ready: no permission to open {plugged[0]['port'] or plugged[0]['node']}. The fix is below."
    built_in = next((str(one["port"]) for one in ports if one["state"] == "built-in UART"), None)
    wired = f" Is it wired to {built_in}? Then test it: eitskin doctor --port {built_in}" if built_in else ""
    return f"No skin found. Plug it in, or start a virtual one: eitskin virtual-skin (extra: sim).{wired}"


def greet(port: str, baud: int = DEFAULT_BAUD) -> dict[str, Any]:
    """Return what the device on a port reports, the state of its line, and what is wrong with either.

    Args:
        port: A serial port's path, or ``usb:SERIAL``.
        baud: Bits per second on a real UART.

    Raises:
        TransportError: The port is missing, busy, denied or lost.
        HandshakeError: The device does not answer, or measures in a way that cannot be used.
        MismatchError: It was built for another protocol_id.
    """
    transport = open_line(port, baud)
    try:
        device = Device(transport)
        hello = device.hello
        sample = None if hello.flags & HelloFlag.STREAMING else device.ask_time()
        answer_ms = None if sample is None else round(sample.round_trip_ns / 1e6, 3)
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
            "flags": [flag.name for flag in HelloFlag if hello.flags & flag],
            "line": transport.report(),
            "answer_ms": answer_ms,
            "verdict": f"Ready: skin {hello.serial_number} answers on {port}.",
            "problems": _device_problems(port, hello, answer_ms),
        }
    finally:
        transport.close()


def _device_problems(port: str, hello: Hello, answer_ms: float | None) -> list[str]:
    found = []
    if hello.flags & HelloFlag.FACTORY:
        found.append(f"it runs its built-in configuration; store one: 'eitskin flash write paper --port {port}'")
    if hello.flags & HelloFlag.TRIAL:
        found.append("its configuration is on trial and rolls back within 30 s: let 'eitskin flash write' finish")
    if hello.flags & HelloFlag.ROLLED_BACK:
        found.append(
            "it rolled back the last flashed configuration, which was never confirmed: flash it again with --port "
            f"{port}"
        )
    if hello.flags & HelloFlag.STREAMING:
        found.append("it still streams for a program that ended without stopping it: 'eitskin run' restarts it")
    if answer_ms is not None and answer_ms > SLOW_ANSWER_MS:
        found.append(
            f"it takes at least {answer_ms:g} ms to answer, expected at most {SLOW_ANSWER_MS:g}: look for a latency "
            "timer (see the port above), a hub, or a busy machine"
        )
    return found


def _port(info: Any, problems: list[str]) -> dict[str, Any]:
    usb = f"{info.vid:04x}:{info.pid:04x} {info.serial_number or ''}".strip() if info.vid is not None else ""
    state = "usable" if usb else "built-in UART"
    kind = UART_TYPES / Path(info.device).name / "type"
    if not usb and kind.exists() and kind.read_text(encoding="ascii").strip() == "0":
        state = "no hardware"
    elif not os.access(info.device, os.R_OK | os.W_OK):
        state = "no permission"
        problems.append(f"{info.device}: run 'sudo usermod -aG dialout $USER', then log in again")
    timer = ADAPTERS / Path(info.device).name / "latency_timer"
    if timer.exists():
        waits_ms = int(timer.read_text(encoding="ascii").strip() or 0)
        state += f", latency timer {waits_ms} ms"
        if waits_ms > SLOW_LATENCY_MS:
            problems.append(
                f"{info.device}: bytes wait up to {waits_ms} ms; run 'echo 1 | sudo tee {timer}', or add a udev rule "
                'with ATTR{latency_timer}="1"'
            )
    return {"port": info.device, "description": info.description, "id": usb, "state": state}


def _usb(problems: list[str]) -> list[dict[str, Any]]:
    """Return the skins with USB endpoints of their own."""
    from eitskin.acquisition import usb_port  # noqa: PLC0415 -- pyusb is only loaded by who uses it

    try:
        found = usb_port.devices()
    except SkinError as error:
        problems.append(str(error))
        return []
    rule = any((folder / usb_port.RULE_FILE.name).is_file() for folder in SYSTEM_RULES)
    listed = []
    for one in found:
        state = "usable" if one.usable else "no permission"
        if not one.usable:
            problems.append(
                f"{one.node}: run {usb_port.RULE}" + (" (the rule is installed: plug it in again)" if rule else "")
            )
        elif not one.serial_number:
            state = "no serial number"
            problems.append(f"{one.node}: the device has no serial number, so two of them cannot be told apart")
        listed.append(
            {"port": one.port, "node": one.node, "id": f"{usb_port.VENDOR_ID:04x}:{usb_port.PRODUCT_ID:04x}",
             "serial_number": one.serial_number, "state": state, "udev_rule": rule}
        )  # fmt: skip
    return listed


def _shipped() -> list[tuple[str, Path]]:
    """Labels and places of the shipped bundles: those of every installation, then those for lowering touches."""
    always = [(labels, default_path(labels)) for labels in LABELS]
    lowering = [(labels, default_path(labels, "lower")) for labels in LABELS]
    return [*always, *((labels, path) for labels, path in lowering if path.exists())]


def _bundle(labels: str, path: Path, problems: list[str]) -> dict[str, Any]:
    try:
        found = load_bundle(path)
    except SkinError as error:
        problems.append(str(error))
        return {"path": str(path), "labels": labels, "touches": "", "id": "", "state": "unusable"}
    state = f"intact, labels {found.labels}, touches {found.touch_kind}, {found.id}"
    return {"path": str(path), "labels": labels, "touches": found.touch_kind, "id": found.id, "state": state}


def _limit(name: str, which: int) -> str:
    soft, hard = resource.getrlimit(which)
    words = ["unlimited" if value == resource.RLIM_INFINITY else str(value) for value in (soft, hard)]
    return f"{name}: {words[0]} of at most {words[1]}"
