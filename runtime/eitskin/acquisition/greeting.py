"""Checks every HELLO of a device: the first, every later one, and the one after a port returned.

It bounds the numbers on which everything else depends: the unit of a count, the rate (it decides when a stream is
silent and how long a reference may take), the rows and the width of a sample.
"""

from typing import Final

from eitskin.errors import HandshakeError
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS
from eitskin_proto.wire.frames import SAMPLE_BYTES, frame_bytes
from eitskin_proto.wire.framing import wire_bytes
from eitskin_proto.wire.messages import Hello
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_proto.wire.volts import DriverHello

VOLTS_PER_COUNT: Final = (1e-15, 1e3)
"""V, least and most; a value outside is not in volts."""

RATE_MHZ: Final = (100, 100_000_000)
"""Least and most, in thousandths of a hertz: one frame in 10 s, and 100,000 a second."""

FIXED_FIELDS: Final = ("volts_per_count", "rows", "sample_bytes", "drives", "idle_drives", "rate_mHz")
"""Fields of the configuration or the electronics, which must not change between two HELLOs."""


def check_usable(hello: Hello, line_bytes_per_s: int) -> None:
    """Refuse a device whose frames this runtime cannot turn into maps, or whose line cannot carry them.

    Args:
        hello: Its HELLO.
        line_bytes_per_s: Capacity of this side of the line; 0 for no limit.

    Raises:
        HandshakeError: What was found, what was expected, and what to do.
    """
    hint = "flash another configuration with 'eitskin flash'"
    _check_rate(hello, "correct its driver" if isinstance(hello, DriverHello) else hint)
    if isinstance(hello, DriverHello):
        return
    if hello.rows not in (N_ROWS, N_FULL_ROWS) or hello.drives != ALL_DRIVES:
        raise HandshakeError(
            f"configuration {hello.configuration_name} measures {hello.rows} rows of drives 0x{hello.drives:04x}, "
            f"expected {N_ROWS} or {N_FULL_ROWS} rows of all 16 drives; {hint}"
        )
    if hello.full != (hello.rows == N_FULL_ROWS):
        raise HandshakeError(
            f"HELLO.rows: found {hello.rows}, but its flags mean {N_FULL_ROWS if hello.full else N_ROWS}; update the "
            "firmware"
        )
    low, high = VOLTS_PER_COUNT
    if not low <= hello.volts_per_count <= high:
        raise HandshakeError(
            f"HELLO.volts_per_count: found {hello.volts_per_count:g} V, expected more than 0, at least {low:g} and at "
            f"most {high:g} V; update the firmware"
        )
    if hello.sample_bytes not in SAMPLE_BYTES:
        raise HandshakeError(f"HELLO.sample_bytes: found {hello.sample_bytes}, expected 2, 3 or 4; update the firmware")
    limits = [limit for limit in (line_bytes_per_s, hello.line_bytes_per_s) if limit > 0]
    packet = wire_bytes(frame_bytes(hello.rows, hello.sample_bytes))
    if limits and hello.rate_mHz * packet > min(limits) * 1000:
        raise HandshakeError(
            f"{hello.rate_mHz / 1000:g} frames/s of {packet} bytes do not fit a line of {min(limits)} bytes/s, which "
            f"carries {min(limits) // packet} frames/s: raise --baud, or {hint}"
        )


def _check_rate(hello: Hello, hint: str) -> None:
    slow, fast = RATE_MHZ
    if not slow <= hello.rate_mHz <= fast:
        raise HandshakeError(
            f"HELLO.rate_mHz: found {hello.rate_mHz}, expected {slow} to {fast} ({slow / 1000:g} to "
            f"{fast // 1000} frames/s); {hint}"
        )


def check_same(known: Hello, found: Hello, port: str) -> None:
    """Refuse a device that is not the one that was known, or measures otherwise: its reference holds no longer.

    Args:
        known: Its earlier HELLO.
        found: Its present HELLO, usable by itself.
        port: Name of the line.

    Raises:
        HandshakeError: What is found now, what was expected, and what to do.
    """
    if found.serial_number != known.serial_number:
        raise HandshakeError(
            f"{port}: the device is now {found.serial_number}, expected {known.serial_number}; "
            "start again, with the reference of this device"
        )
    remedy = f"capture a new reference: eitskin reference --port {port} --out FILE"
    if found.configuration_digest != known.configuration_digest:
        raise HandshakeError(
            f"{port}: the configuration is now {found.configuration_name}/{found.configuration_digest:08x}, expected "
            f"{known.configuration_name}/{known.configuration_digest:08x}; {remedy}"
        )
    for name in FIXED_FIELDS[:-1] if isinstance(known, DriverHello) else FIXED_FIELDS:  # a driver may measure its rate
        before, now = getattr(known, name), getattr(found, name)
        if before != now:
            raise HandshakeError(
                f"{port}: HELLO.{name} is now {now:g}, expected {before:g} as before in the same configuration; "
                f"{remedy}"
            )
