"""``robot.json``: the state of the skins that ``eitskin run --config`` runs, in its folder.

The parent writes it whole, whenever a process starts, is ready or ends. It gives programs the names, endpoints and
poses, so that they need no robot.toml::

    {"format": "eitskin-robot-state", "version": 1, "pid": 4711,
     "skins": [{"name": "left-arm", "publish": "ipc://...", "control": "ipc://...", "rotation": [[...]],
                "translation_mm": [...], "state": "ready", "pid": 4712, "restarts": 0, "why": ""}]}
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from eitskin.errors import EndpointError, RobotError
from eitskin.messaging.endpoints import ROBOT, needs_keys, runtime_folders
from eitskin.robot.config import MAX_SKINS, NAME, Robot, RobotSkin, load_robot
from eitskin.robot.pose import Pose
from eitskin_proto.fields import Fields
from eitskin_proto.files.plain import plain
from eitskin_proto.files.reading import read_json
from eitskin_proto.files.writing import write_bytes

FORMAT: Final = "eitskin-robot-state"
VERSION: Final = 1

FILE: Final = ROBOT
"""In the folder."""

MAX_FILE_BYTES: Final = 256 << 10
"""Bytes of the file."""

STATES: Final = ("starting", "ready", "waiting", "failed", "ended")
"""Of a skin's process; waiting is for the next start."""


@dataclass(frozen=True, slots=True)
class ProcessState:
    """One skin, and how its process is.

    Attributes:
        skin: Name, endpoints and pose.
        state: One of ``STATES``; empty where only a robot.toml was read.
        pid: Of its process; 0 for none.
        restarts: How often it was started again.
        why: It ended the last time, in a line; empty if it never has.
    """

    skin: RobotSkin
    state: str = ""
    pid: int = 0
    restarts: int = 0
    why: str = ""


def write_states(folder: Path, pid: int, states: Sequence[ProcessState]) -> None:
    """Write the file whole.

    Raises:
        OSError: It cannot be written.
    """
    skins = [
        {
            "name": one.skin.name, "publish": one.skin.publish, "control": one.skin.control, **one.skin.pose.fields(),
            "state": one.state, "pid": one.pid, "restarts": one.restarts, "why": one.why,
        }
        for one in states
    ]  # fmt: skip
    content = {"format": FORMAT, "version": VERSION, "pid": pid, "skins": skins}
    write_bytes(folder / FILE, (json.dumps(content) + "\n").encode(), 0o600)


def read_states(folder: Path) -> tuple[ProcessState, ...]:
    """Return the skins of a folder in which ``eitskin run --config`` runs, or ran.

    Raises:
        RobotError: There is no robot.json, or it is malformed.
    """
    path = folder / FILE
    try:
        found = read_json(path, MAX_FILE_BYTES)
    except FileNotFoundError:
        raise RobotError(
            f"no {path}: no skins run there; start them with 'eitskin run --config robot.toml', or name the robot.toml"
        ) from None
    except (OSError, ValueError) as error:
        raise RobotError(f"{path} cannot be read: {error}") from error
    try:
        return _states(found)
    except (KeyError, TypeError, ValueError, EndpointError) as error:
        raise RobotError(f"{path} does not have this release's format ({error}): use the runtime's release") from error


def _states(found: object) -> tuple[ProcessState, ...]:
    content = Fields(found, "")
    content.check_format(FORMAT, VERSION, "a robot's state")
    listed = content.entries("skins", least=1, most=MAX_SKINS, of="skins")
    return tuple(_state(listed.table(place)) for place in listed)


def _state(one: Fields) -> ProcessState:
    name = one.text("name")
    if NAME.fullmatch(name) is None:
        raise one.wrong("name", "a skin's name")
    publish, control = one.text("publish"), one.text("control")
    for endpoint in (publish, control):
        needs_keys(endpoint)  # refuses what is no endpoint
    pose = Pose.of(rotation=one.value("rotation"), translation_mm=one.value("translation_mm"))
    state = one.choice("state", STATES)
    why = plain(str(one.value("why")))
    return ProcessState(RobotSkin(name, publish, control, pose), state, one.whole("pid"), one.whole("restarts"), why)


Source = str | Path | Robot | None
"""A robot.toml, a folder in which ``eitskin run --config`` runs, what was loaded; None for the default folder."""


def states_of(source: Source = None) -> tuple[ProcessState, ...]:
    """Return the skins of a robot, in its own order, and how their processes are where that is known.

    Raises:
        RobotError: There are no skins, or the file is wrong.
        OSError: There is no such file.
    """
    if isinstance(source, Robot):
        return tuple(ProcessState(one.skin) for one in source.skins)
    if source is None:
        folders = runtime_folders()
        return read_states(next((one for one in folders if (one / FILE).exists()), folders[0]))
    path = Path(source)
    return read_states(path) if path.is_dir() else states_of(load_robot(path))


def robot_skins(source: Source = None) -> tuple[RobotSkin, ...]:
    """Return names, endpoints and poses of a robot's skins, in the order of its robot.toml.

    Args:
        source: Path of a robot.toml, or of the folder in which ``eitskin run --config`` runs; None for the default.

    Raises:
        RobotError: There are no skins, or the file is wrong.
        OSError: There is no such file.
    """
    return tuple(one.skin for one in states_of(source))
