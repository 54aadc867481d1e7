"""HELLOs with one field drawn from anywhere: what is taken must be what a skin can be, first time and every time."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from eitskin.acquisition.device import Device
from eitskin.errors import HandshakeError, SkinError
from eitskin_proto.wire.codes import HelloFlag

from ..outcome import Effort, Outcome
from .lying_line import HELLO, Line


def _drawn(rng: np.random.Generator) -> dict[str, Any]:
    """Return fields that differ from an honest HELLO's."""
    what = rng.choice(["volts_per_count", "rate_mHz", "rows", "sample_bytes", "drives", "flags", "serial_number",
                       "configuration_digest"])  # fmt: skip
    match str(what):
        case "volts_per_count":
            size = 10.0 ** rng.uniform(-300, 300)
            return {"volts_per_count": float(rng.choice([size, -size, 0.0, -1e-9, 1e-9 * (1 + 1e-12)]))}
        case "rate_mHz":
            return {"rate_mHz": int(rng.choice([0, 1, 99, 2**32 - 1, int(2.0 ** rng.uniform(0, 32))]))}
        case "rows":
            return {"rows": int(rng.choice([0, 39, 103, 208, 255]))}
        case "sample_bytes":
            return {"sample_bytes": int(rng.choice([0, 1, 5, 255, 2, 3]))}
        case "drives":
            return {"drives": int(rng.integers(0, 0xFFFF))}
        case "flags":
            return {"flags": int(HelloFlag.FULL)}
        case "serial_number":
            return {"serial_number": "LIAR-2"}
        case _:
            return {"configuration_digest": int(rng.integers(2, 2**32))}


def _usable(fields: dict[str, Any]) -> bool:
    """Return whether a device may say this the first time; written down apart from the code that judges."""
    found = {"volts_per_count": 1e-9, "rate_mHz": 100_000, "rows": 104, "sample_bytes": 4, "drives": 0xFFFF, "flags": 0}
    found |= fields
    volts = found["volts_per_count"]
    return bool(
        math.isfinite(volts) and 1e-15 <= volts <= 1e3
        and 100 <= found["rate_mHz"] <= 100_000_000
        and found["rows"] == (208 if found["flags"] & 1 else 104)
        and found["sample_bytes"] in (2, 3, 4)
        and found["drives"] == 0xFFFF
    )  # fmt: skip


def hello(effort: Effort) -> Outcome:
    """Draw HELLOs; each is shown as the first one, and to a runtime that knows the honest one."""
    outcome = Outcome("front-end.hello")
    rng = np.random.default_rng(effort.seed)
    for draw in range(effort.count(200, 20_000)):
        fields = _drawn(rng)
        line = Line(lambda _line, _n: b"", hello=replace(HELLO, **fields))
        outcome.note(_taken(line) == _usable(fields), f"first HELLO with {fields}, draw {draw}, seed {effort.seed}")
        line = Line(lambda _line, _n: b"")
        device = Device(line)
        line.hello = replace(HELLO, **fields)
        try:
            device.recover()
            same = True
        except HandshakeError:
            same = False
        outcome.note(same == (line.hello == HELLO), f"later HELLO with {fields}, draw {draw}, seed {effort.seed}")
    return outcome


def _taken(line: Line) -> bool:
    try:
        Device(line)
    except SkinError:
        return False
    return True
