"""Every attack by name: where its function is. ``make attack`` runs all; each folder's tests run the short form."""

from importlib import import_module

from .outcome import Attack

ATTACKS: dict[str, str] = {
    "firmware.flashing": "requests.flashing:flashing",
    "front-end.lies": "line.lies:lies",
    "front-end.honest": "line.lies:honest",
    "front-end.hanging": "line.hanging:hanging",
    "device.damage": "line.wire:damage",
    "device.foreign": "line.wire:foreign_packets",
    "device.heads": "line.wire:heads",
    "control.requests": "control.requests:hostile_requests",
    "run.terminated": "shutdown.moments:random_moments",
    "subscribers.held": "subscribers.border:held",
    "subscribers.without-keys": "subscribers.border:without_keys",
    "subscribers.honest": "subscribers.crowds:honest_crowds",
    "files.readers": "files.attack:files",
}
"""Name of an attack, and ``folder.module:function`` below this folder."""


def load(name: str) -> Attack:
    """Return an attack's function."""
    module, function = ATTACKS[name].split(":")
    found: Attack = getattr(import_module(f"tests.attack.{module}"), function)
    return found
