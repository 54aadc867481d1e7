"""Every attack by name: where its function is. ``make attack`` runs all; each folder's tests run the short form."""

from importlib import import_module

from .outcome import Attack

ATTACKS: dict[str, str] = {
    "requests": "requests.sequences:requests",
    "board_requests": "requests.sequences:board_requests",
    "flashing": "requests.flashing:flashing",
    "front_end_lies": "front_end.lies:lies",
    "front_end_honest": "front_end.lies:honest",
    "front_end_references": "front_end.lies:references",
    "front_end_hanging": "front_end.hanging:hanging",
    "front_end_hello": "front_end.hello:hello",
    "control": "control.requests:hostile_requests",
    "keys": "control.keys:key_folders",
    "shutdown": "shutdown.moments:random_moments",
    "unknown-unsubscriptions": "subscribers.topics:unknown_unsubscriptions",
    "topic-floods": "subscribers.topics:topic_floods",
    "connect-floods": "subscribers.floods:connect_floods",
    "few-descriptors": "subscribers.floods:few_descriptors",
    "silent-crowds": "subscribers.crowds:silent_crowds",
    "honest-crowds": "subscribers.crowds:honest_crowds",
    "giant-messages": "subscribers.giants:giant_messages",
    "denormals": "numbers.denormals:denormals",
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
    "files": "files.attack:files",
    "runs": "files.attack:runs",
    "command-line": "files.command_line:command_line",
}
"""Name of an attack, and ``folder.module:function`` below this folder."""


def load(name: str) -> Attack:
    """Return an attack's function."""
    module, function = ATTACKS[name].split(":")
    found: Attack = getattr(import_module(f"tests.attack.{module}"), function)
    return found
