"""What a hostile device does to its line, by name: ``process`` passes what it would send through one of these.

An attack lasts for a number of scans, then the device is honest again. Whatever it draws, it draws from its seed.
"""

import random
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .process import Machine


class Attack:
    """Does nothing; others override what they change."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        self.machine = machine
        self.order = order
        self.seed: int = order.get("seed", 0)
        self.random = random.Random(self.seed)
        self._last = machine.made + order.get("frames", 100)
        self._until_s = time.monotonic() + order.get("seconds", 30.0)
        """Silent or not, it ends then."""
        if order.get("restarted"):  # so that the host must greet while it lasts
            machine.restart()

    def send(self, payload: bytes) -> bool:
        """Send a payload another way; return False to have it sent as it is."""
        return False

    def request(self, payload: bytes) -> bool:
        """Take a host's request; return False to have it answered as usual."""
        return False

    def idle(self) -> None:
        """Do what is not a reaction; called at least 50 times a second."""
        if self.machine.made >= self._last or time.monotonic() >= self._until_s:
            self.end()

    def end(self) -> None:
        """Become honest again."""
        self.machine.done()


def begin(machine: "Machine", order: dict[str, Any]) -> Attack:
    """Return the attack that an order names."""
    from . import damage, foreign, lies, silence

    known: dict[str, type[Attack]] = {"nothing": Attack}
    for module in (damage, foreign, lies, silence):
        known |= module.KNOWN
    return known[order["do"]](machine, order)
