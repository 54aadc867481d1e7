"""Every attack by name: where its function is. ``make attack`` runs all; each folder's tests run the short form."""

from importlib import import_module

from .outcome import Attack

ATTACKS: dict[str, str] = {
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
