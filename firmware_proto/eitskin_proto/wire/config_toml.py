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
from pathlib import Path
from typing import Any, Final

from eitskin_proto.files.plain import plain, quoted
from eitskin_proto.files.reading import parse_toml
from eitskin_proto.files.shipped import is_name, parse_file, text_named
from eitskin_proto.wire import hardware
from eitskin_proto.wire.config import FORMAT, Configuration
from eitskin_proto.wire.scan_rows import drives_from_list, drives_to_list

NAMED: Final = ("paper", "full208", "idle", "fast")
"""Configurations that come with the package."""

KEYS: Final[dict[str, dict[str, type]]] = {
    "": {"format": int, "name": str, "revision": int, "hardware": str, "skin": str},
    "drive": {"frequency_Hz": int, "current_uA": int},
    "measure": {"settle_us": int, "averages_periods": int, "gain": int, "sample_bits": int},
    "scan": {"rows": int, "drives": list, "rate_Hz": float},
    "idle": {"drives": list, "rate_Hz": float},
}
"""Tables and keys with their types; all are required, except skin, and that [idle] may be missing as a whole."""

FIELDS: Final = {
    "": ("name", "revision", "hardware_id", "skin"),
    "drive": ("frequency_hz", "current_ua"),
    "measure": ("settle_us", "averages", "gain", "sample_bytes"),
    "scan": ("rows", "drives", "rate_mHz"),
    "idle": ("idle_drives", "idle_rate_mHz"),
}
"""Fields of a configuration by the tables that hold them; a skin that is none is left out."""


def _where(table: str) -> str:
    return f"[{table}]" if table else "the head of the file"


def _unknown(key: str, table: str) -> str:
    stem = key.split("_", maxsplit=1)[0].lower()
    for other_table, keys in KEYS.items():
        for known in keys:
            if known.split("_")[0].lower() == stem and (known != key or other_table != table):
                what = "in another unit or spelling" if known != key else "there"
                return f"unknown key {quoted(key)} in {_where(table)}: {_where(other_table)} has {known!r} {what}"
    return f"unknown key {quoted(key)} in {_where(table)}; known are {', '.join(KEYS[table])}"


def _value(content: dict[str, Any], table: str, key: str) -> Any:
    kind = KEYS[table][key]
    if key not in content:
        raise ValueError(f"{_where(table)} lacks {key!r}")
    value = content[key]
    fits = isinstance(value, int | float if kind is float else kind) and not isinstance(value, bool)
    if kind is list:
        fits = fits and all(isinstance(item, int) and not isinstance(item, bool) for item in value)
    if not fits:
        expected = "a list of int" if kind is list else kind.__name__
        raise ValueError(f"{key} in {_where(table)} is {quoted(value)}, expected {expected}")
    return value


def _rate_mHz(rate_hz: float, table: str) -> int:
    if not 0.001 <= rate_hz <= 4e6:
        raise ValueError(f"rate_Hz in [{table}] is {quoted(rate_hz)}, expected 0.001 to 4e6")
    return round(rate_hz * 1000)


def parse(text: str) -> Configuration:
    """Return the configuration of a TOML text.

    Raises:
        ValueError: Not TOML, an unknown or missing key, a wrong type or an impossible value; each named.
    """
    content = parse_toml(text)
    tables: dict[str, dict[str, Any]] = {"": {}}
    for key, value in content.items():
        if isinstance(value, dict) and key in KEYS:
            tables[key] = value
        elif isinstance(value, dict):
            raise ValueError(f"unknown table [{plain(key)}]; known are " + ", ".join(f"[{t}]" for t in KEYS if t))
        else:
            tables[""][key] = value
    for table, entries in tables.items():
        for key in entries:
            if key not in KEYS[table]:
                raise ValueError(_unknown(key, table))
    for table in ("drive", "measure", "scan"):
        if table not in tables:
            raise ValueError(f"the table [{table}] is missing")

    def get(table: str, key: str) -> Any:
        return _value(tables[table], table, key)

    if get("", "format") != FORMAT:
        raise ValueError(f"format is {quoted(get('', 'format'))}, this release reads format {FORMAT}")
    bits = get("measure", "sample_bits")
    if bits not in (16, 24, 32):
        raise ValueError(f"sample_bits is {quoted(bits)}, expected 16, 24 or 32")
    idle = "idle" in tables
    return Configuration(
        name=get("", "name"),
        revision=get("", "revision"),
        hardware_id=hardware.by_name(get("", "hardware")).id,
        frequency_hz=get("drive", "frequency_Hz"),
        current_ua=get("drive", "current_uA"),
        settle_us=get("measure", "settle_us"),
        averages=get("measure", "averages_periods"),
        gain=get("measure", "gain"),
        sample_bytes=bits // 8,
        rows=get("scan", "rows"),
        drives=drives_from_list(get("scan", "drives")),
        rate_mHz=_rate_mHz(get("scan", "rate_Hz"), "scan"),
        idle_drives=drives_from_list(get("idle", "drives")) if idle else 0,
        idle_rate_mHz=_rate_mHz(get("idle", "rate_Hz"), "idle") if idle else 0,
        skin=get("", "skin") if "skin" in tables[""] else "",
    )


def to_toml(configuration: Configuration) -> str:
    """Return the TOML text of a configuration; ``parse`` gives the same configuration back.

    Raises:
        ValueError: Its hardware is unknown.
    """
    hardware.by_id(configuration.hardware_id)
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
        return "hardware", hardware.by_id(value).name if value in hardware.KNOWN else f"0x{value:08x}"
    if of_both == "drives":
        return f"{idle}drives", drives_to_list(value)
    if of_both in ("rate_mHz", "rate_millihertz"):
        return f"{idle}rate_Hz", value / 1000
    if field == "sample_bytes":
        return "sample_bits", 8 * value
    names = {"frequency_hz": "frequency_Hz", "current_ua": "current_uA", "averages": "averages_periods"}
    return names.get(field, field), value


def load(path: str | Path) -> Configuration:
    """Return the configuration of a TOML file, or of one that comes with the package if only its name is given.

    Raises:
        ValueError: The file's content is wrong; the text names file and key.
        OSError: There is no such file.
    """
    if is_name(path, NAMED):
        return named(str(path))
    return parse_file(path, parse)


def named(name: str) -> Configuration:
    """Return a configuration that comes with the package: paper, full208, idle or fast.

    Raises:
        ValueError: There is none of this name.
    """
    return parse(text_named(name, NAMED, "configurations", "configuration"))
