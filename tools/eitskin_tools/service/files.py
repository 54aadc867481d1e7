"""Files that a system wants of whoever runs skins as a service: units of systemd, a rule of udev, a container's recipe.

They come with the package as templates: ``{user}`` and ``{eitskin}`` are put in, and ``{common}`` is what both units
share.
"""

import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

FOLDER: Final = "shipped"

COMMON: Final = "common.conf"

USER: Final = re.compile(r"[a-z_][a-z0-9_-]{0,30}")
PROGRAM: Final = re.compile(r"(/[A-Za-z0-9._+@-]+)+")


@dataclass(frozen=True, slots=True)
class ServiceFile:
    """One of the files.

    Attributes:
        name: Its name.
        home: The folder of the system in which it belongs; empty for none.
        what: For people.
    """

    name: str
    home: str
    what: str


FILES: Final = (
    ServiceFile("eitskin.service", "/etc/systemd/system", "all skins of /etc/eitskin/robot.toml"),
    ServiceFile("eitskin@.service", "/etc/systemd/system", "eitskin@NAME: the skins of /etc/eitskin/NAME.toml"),
    ServiceFile("61-eitskin-start.rules", "/etc/udev/rules.d", "starts eitskin.service when a skin is plugged in"),
    ServiceFile("Containerfile", "", "a container that runs /etc/eitskin/robot.toml"),
)


def text_of(name: str, user: str, program: str) -> str:
    """Return the text of a file.

    Args:
        name: One of ``FILES``.
        user: Who runs the skins.
        program: Path of the ``eitskin`` that the units start.

    Raises:
        ValueError: There is no such file, or user or program do not fit into a unit.
    """
    if name not in (one.name for one in FILES):
        raise ValueError(f"no file {name!r}, expected one of {', '.join(one.name for one in FILES)}")
    if USER.fullmatch(user) is None:
        raise ValueError(f"user is {user!r}, expected a name such as robot: small letters, digits, - and _")
    if PROGRAM.fullmatch(program) is None:
        raise ValueError(
            f"program is {program!r}, expected an absolute path without blanks, such as /opt/eitskin/bin/eitskin"
        )
    text = _read(name)
    if name.endswith(".service"):
        text = text.replace("{common}", _read(COMMON)).replace("{user}", user).replace("{eitskin}", program)
    return text


def _read(name: str) -> str:
    return resources.files("eitskin_tools.service").joinpath(FOLDER, name).read_text(encoding="utf-8")


def write(root: Path, user: str, program: str, *, homes: bool) -> list[Path]:
    """Write the files and return where they are.

    Args:
        root: Folder to write into; ``/`` for the system itself.
        user: See :func:`text_of`.
        program: See :func:`text_of`.
        homes: Into the folders in which the system wants them, those without one left out; else side by side.

    Raises:
        ValueError: See :func:`text_of`.
        OSError: They cannot be written.
    """
    from eitskin_proto.files.writing import write_bytes

    texts = {one: text_of(one.name, user, program) for one in FILES if one.home or not homes}
    written = []
    for one, text in texts.items():
        folder = root / one.home.lstrip("/") if homes else root
        folder.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / one.name, text.encode(), 0o644)
        written.append(folder / one.name)
    return written
