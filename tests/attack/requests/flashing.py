"""A device that lies against ``eitskin flash``: every exchange ends, in one line, and believes nothing it can check."""

import random
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from eitskin_proto.errors import SkinError
from eitskin_proto.wire import config_toml
from eitskin_tools.flash import procedure
from eitskin_tools.flash.exchange import Exchange

from ..outcome import Effort, Outcome
from .hostile_device import LIES, EndlessError, HostileDevice

WANTED: Final = replace(config_toml.named("paper"), name="wanted", idle_drives=0, idle_rate_mHz=0)

ACTIONS: Final[dict[str, Callable[[Exchange], object]]] = {
    "show": procedure.show,
    "verify": lambda exchange: procedure.verify(exchange, WANTED),
    "write": lambda exchange: procedure.write(exchange, WANTED),
    "rollback": procedure.rollback,
}

REFUSED: Final = ("less data", "more data", "another slot", "another offset", "another size", "bent data")
"""Lies that the host can see through at once."""

MOST_S: Final = 60.0
"""Each wait inside has its own limit; all of them together stay under this on a machine under load."""


def _one_line(text: str) -> bool:
    return bool(text) and text.isprintable() and len(text) < 600


def ended_well(action: str, lies: list[str], seed: int, share: float) -> str:
    """Return what did not hold in one exchange; nothing if all did."""
    device = HostileDevice(lies, seed)
    exchange = Exchange(device, timeout_s=0.01, attempts=2)
    if action == "rollback":  # there must be something to go back to
        device.share = 0.0
        for configuration in (config_toml.named("fast"), WANTED):
            procedure.write(exchange, configuration)
    device.share = share if lies else 0.0
    began_s = time.monotonic()
    try:
        ACTIONS[action](exchange)
    except EndlessError as error:
        return f"goes on without end: {error}"
    except SkinError as error:
        if not lies:
            return f"an honest device: {error}"
        return "" if _one_line(str(error)) else f"not one line: {error!r}"
    if time.monotonic() - began_s > MOST_S:
        return f"took {time.monotonic() - began_s:.0f} s"
    if share == 1.0 and lies and lies[0] in REFUSED:
        return "was believed"
    if action == "write" and device.running != (WANTED.to_blob(), True):
        return "said that it was written, and the device neither runs nor confirmed it"
    return ""


def flashing(effort: Effort) -> Outcome:
    """Try every lie on every action, then mixtures of lies and honest answers."""
    outcome = Outcome("firmware.flashing")
    for action in ACTIONS:
        outcome.note((found := ended_well(action, [], 0, 0.0)) == "", f"{action}: {found}")
        for lie in LIES:
            found = ended_well(action, [lie], effort.seed, 1.0)
            outcome.note(found == "", f"{action}, {lie!r}: {found}")
    rng = random.Random(effort.seed)
    for number in range(effort.count(200, 4000)):
        action, seed = rng.choice(list(ACTIONS)), effort.seed * 1_000_003 + number
        share = rng.choice((0.05, 0.1, 0.3))
        found = ended_well(action, list(LIES), seed, share)
        outcome.note(found == "", f"{action}, any lie, share {share}, seed {seed}: {found}")
    return outcome
