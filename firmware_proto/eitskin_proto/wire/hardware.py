"""The limits of each kind of electronics, so that an impossible configuration is refused before it is sent.

The front end drives one pair at a time and samples every measured pair at once: a scan takes, for every drive that has
rows, the settling time and then ``averages`` whole periods of the drive frequency.
"""

from dataclasses import dataclass
from typing import Final

from eitskin_proto.files.plain import quoted


@dataclass(frozen=True, slots=True)
class Hardware:
    """The limits of one kind of electronics."""

    id: int
    """Its id in HELLO and in every configuration."""
    name: str
    """Its name in a TOML file."""
    min_frequency_hz: int
    max_frequency_hz: int
    max_current_ua: int
    gains: tuple[int, ...]
    """Linear gains that the amplifier has."""
    min_settle_us: int
    """The multiplexers need this long, whatever the configuration says."""
    scan_overhead_us: int
    """Reading the converters and packing the frame."""


EITSKIN_16: Final = Hardware(
    id=0x45533136,
    name="eitskin-16",
    min_frequency_hz=1_000,
    max_frequency_hz=100_000,
    max_current_ua=5_000,
    gains=(1, 2, 4, 8, 16, 32),
    min_settle_us=20,
    scan_overhead_us=20,
)
"""Sixteen electrodes, thirteen parallel converters; the virtual and the emulated skin are of this kind."""

KNOWN: Final = (EITSKIN_16,)
"""Every kind."""


def hardware_of(which: int | str) -> Hardware:
    """Return the electronics of this id or name.

    Raises:
        ValueError: There is none; the text lists those that exist.
    """
    for one in KNOWN:
        if which in (one.id, one.name):
            return one
    found = f"0x{which:08x}" if isinstance(which, int) else quoted(which)
    known = ", ".join(f"{one.name!r} (0x{one.id:08x})" for one in KNOWN)
    raise ValueError(f"hardware {found} is unknown; known are {known}")


def name_of(hardware_id: int) -> str:
    """Return the name of these electronics, or the digits of an unknown id."""
    return next((one.name for one in KNOWN if one.id == hardware_id), f"0x{hardware_id:08x}")
