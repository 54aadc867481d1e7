"""HELLOs with one field drawn from anywhere: what is taken must be what a skin can be, first time and every time."""

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any, Final

import numpy as np

from eitskin.acquisition.device import Device
from eitskin.errors import SkinError

from ..outcome import Effort, Outcome
from .line import HELLO, Line

Draw = Callable[[np.random.Generator], Any]

FIELDS: Final[dict[str, Draw]] = {
    "volts_per_count": lambda rng: float(rng.choice([1, 1, -1, 0]) * 10.0 ** rng.choice([rng.uniform(-300, 300), -9])),
    "rate_mHz": lambda rng: int(rng.choice([0, 1, 99, 2**32 - 1, int(2.0 ** rng.uniform(0, 32))])),
    "rows": lambda rng: int(rng.choice([0, 39, 103, 208, 255])),
    "sample_bytes": lambda rng: int(rng.choice([0, 1, 5, 255, 2, 3])),
    "drives": lambda rng: int(rng.integers(0, 0xFFFF)),
    "flags": lambda _: 1,
    "serial_number": lambda _: "LIAR-2",
    "configuration_digest": lambda rng: int(rng.integers(2, 2**32)),
}  # fmt: skip


def _usable(found: dict[str, Any]) -> bool:
    """Return whether a device may say this the first time; written down apart from the code that judges."""
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
        name = str(rng.choice(list(FIELDS)))
        said = replace(HELLO, **{name: FIELDS[name](rng)})
        what = f"{name} {getattr(said, name)}, draw {draw}, seed {effort.seed}"
        line = Line(lambda *_: b"", hello=said)
        outcome.note(_taken(lambda line=line: Device(line)) == _usable(asdict(said)), f"first HELLO with {what}")
        line = Line(lambda *_: b"")
        device = Device(line)
        line.hello = said
        outcome.note(_taken(device.recover) == (said == HELLO), f"later HELLO with {what}")
    return outcome


def _taken(greet: Callable[[], object]) -> bool:
    try:
        greet()
    except SkinError:
        return False
    return True
