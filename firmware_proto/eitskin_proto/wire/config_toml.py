"""A configuration as a TOML file: every key says its unit, and a key that is not known is an error.

::

    format = 1
    name = "paper"
    revision = 1
    hardware = "eitskin-16"
    skin = "15ce2df6c042c8c9"   (which skin it is for: its digest, of 'eitskin skin show'; may be left out)
    [drive]     frequency_Hz = 20000    current_uA = 1000
    [measure]   settle_us = 100         averages_periods = 5    gain = 8    sample_bits = 24
    [scan]      rows = 104              drives = [0, 1, ...]    rate_Hz = 200.0
    [idle]      drives = [0, 1, 2, 3]   rate_Hz = 20.0          (the table may be left out)
"""

import json
from typing import Any, Final

from eitskin_proto.fields import Fields
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import ShippedFiles, parse_toml
from eitskin_proto.wire import hardware
from eitskin_proto.wire.config import FORMAT, Configuration
from eitskin_proto.wire.scan_rows import drives_from_list, drives_to_list

NAMED: Final = ("paper", "full208", "idle", "fast")
"""Configurations that come with the package."""

FIELDS: Final = {
    "": ("name", "revision", "hardware_id", "skin"),
    "drive": ("frequency_hz", "current_ua"),
    "measure": ("settle_us", "averages", "gain", "sample_bytes"),
    "scan": ("rows", "drives", "rate_mHz"),
    "idle": ("idle_drives", "idle_rate_mHz"),
}
"""Fields of a configuration by the tables that hold them; a skin that is none is left out."""


def parse(text: str) -> Configuration:
    """Return the configuration of a TOML text.

    Raises:
        ValueError: Not TOML, an unknown or missing key, a wrong type or an impossible value; each named.
    """
    content = Fields(parse_toml(text), "")
    if content.whole("format") != FORMAT:
        raise ValueError(f"format is {quoted(content.value('format'))}, this release reads format {FORMAT}")
    texts = {"name": content.text("name"), "skin": content.text("skin", "", least=0)}
    revision, hardware_id = content.whole("revision"), hardware.hardware_of(content.text("hardware")).id
    drive, measure, scan, idle = (content.table(name, f"[{name}]") for name in ("drive", "measure", "scan", "idle"))
    content.close()
    bits = measure.whole("sample_bits")
    if bits not in (16, 24, 32):
        raise ValueError(f"sample_bits is {quoted(bits)}, expected 16, 24 or 32")
    drives, rate_mHz = _scanned(scan)
    idle_drives, idle_rate_mHz = _scanned(idle) if len(idle) else (0, 0)
    found = Configuration(
        **texts,
        revision=revision,
        hardware_id=hardware_id,
        frequency_hz=drive.whole("frequency_Hz"),
        current_ua=drive.whole("current_uA"),
        settle_us=measure.whole("settle_us"),
        averages=measure.whole("averages_periods"),
        gain=measure.whole("gain"),
        sample_bytes=bits // 8,
        rows=scan.whole("rows"),
        drives=drives,
        rate_mHz=rate_mHz,
        idle_drives=idle_drives,
        idle_rate_mHz=idle_rate_mHz,
    )
    for table in (drive, measure, scan, idle):
        table.close()
    return found


def _scanned(table: Fields) -> tuple[int, int]:
    """Return the drives, as bits, and the rate in mHz of a table."""
    drives = drives_from_list(list(table.wholes("drives")))
    return drives, round(table.number("rate_Hz", low=0.001, high=4e6) * 1000)


def to_toml(configuration: Configuration) -> str:
    """Return the TOML text of a configuration; ``parse`` gives the same configuration back.

    Raises:
        ValueError: Its hardware is unknown.
    """
    hardware.hardware_of(configuration.hardware_id)
    lines = [f"format = {FORMAT}"]
    for table, fields in FIELDS.items():
        if table == "idle" and not configuration.idle_drives:
            continue
        lines += ["", f"[{table}]"] if table else []
        found = (in_file(field, getattr(configuration, field)) for field in fields)
        lines += [f"{name.removeprefix('idle ')} = {json.dumps(value)}" for name, value in found if value != ""]
    return "\n".join(lines) + "\n"


def in_file(field: str, value: Any) -> tuple[str, Any]:
    """Return a field of a configuration and its value as a file has them: ``sample_bytes`` 3 is ``sample_bits`` 24.

    Args:
        field: Of :class:`Configuration`, or as it is published.
        value: The field's.
    """
    idle, of_both = ("idle ", field.removeprefix("idle_")) if field.startswith("idle_") else ("", field)
    if field == "hardware_id":
        return "hardware", hardware.name_of(value)
    if of_both == "drives":
        return f"{idle}drives", drives_to_list(value)
    if of_both in ("rate_mHz", "rate_millihertz"):
        return f"{idle}rate_Hz", value / 1000
    if field == "sample_bytes":
        return "sample_bits", 8 * value
    names = {"frequency_hz": "frequency_Hz", "current_ua": "current_uA", "averages": "averages_periods"}
    return names.get(field, field), value


FILES: Final = ShippedFiles(NAMED, "configurations", "configuration", parse)
load, named = FILES.load, FILES.named
