"""Every attack by name: where its function is. ``make attack`` runs all; each folder's tests run the short form."""

from importlib import import_module

from .outcome import Attack

ATTACKS: dict[str, str] = {
    "firmware.requests": "requests.sequences:requests",
    "firmware.board": "requests.sequences:board_requests",
    "firmware.flashing": "requests.flashing:flashing",
    "front-end.lies": "front_end.lies:lies",
    "front-end.honest": "front_end.lies:honest",
    "front-end.references": "front_end.lies:references",
    "front-end.hanging": "front_end.hanging:hanging",
    "front-end.hello": "front_end.hello:hello",
    "control.requests": "control.requests:hostile_requests",
    "control.keys": "control.keys:key_folders",
    "run.terminated": "shutdown.moments:random_moments",
    "subscribers.unsubscriptions": "subscribers.border:unsubscriptions",
    "subscribers.held": "subscribers.border:held",
    "subscribers.without-keys": "subscribers.border:without_keys",
    "subscribers.honest": "subscribers.crowds:honest_crowds",
    "subscribers.giants": "subscribers.giants:giant_messages",
    "numbers.denormals": "numbers.denormals:denormals",
    "device.damage": "from_device.wire:damage",
    "device.floods": "from_device.wire:floods",
    "device.foreign": "from_device.wire:foreign",
    "device.numbers": "from_device.lying:numbers",
    "device.wrap": "from_device.lying:wrap",
    "device.clocks": "from_device.lying:clocks",
    "device.heads": "from_device.lying:heads",
    "device.rows": "from_device.lying:rows",
    "device.stuck": "from_device.lying:stuck",
    "device.greetings": "from_device.lying:greetings",
    "device.answers": "from_device.silences:answers",
    "device.restarts": "from_device.silences:restarts",
    "device.hangs": "from_device.silences:hangs",
    "device.terminated": "from_device.silences:terminated",
    "device.hello": "from_device.commands:hello",
    "device.stored": "from_device.commands:stored",
    "files.readers": "files.attack:files",
    "files.runs": "files.attack:runs",
    "files.commands": "files.command_line:command_line",
}
"""Name of an attack, and ``folder.module:function`` below this folder."""


def load(name: str) -> Attack:
    """Return an attack's function."""
    module, function = ATTACKS[name].split(":")
    found: Attack = getattr(import_module(f"tests.attack.{module}"), function)
    return found
