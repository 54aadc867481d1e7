"""Robots' lists of skins, to be damaged: ``robot.toml``, and what ``eitskin run --config`` tells of its skins."""

import json
from pathlib import Path
from typing import Any, Final

from .commanded import commanded

TOML: Final = b"""format = "eitskin-robot"
version = 1
folder = "/nowhere/eitskin"
[[skins]]
name = "left-arm"
port = "/dev/serial/by-id/usb-left"
baud = 2000000
skin = "paper"
touches = "lower"
reference_frames = 100
solver = "tikhonov"
budget_ms = 4.0
every_map = true
idle_after_s = 2.5
exclude_electrodes = [3, 11]
compensate_drift = false
reconnect_s = 60.0
restart = "never"
[skins.pose]
translation_mm = [0, 120.5, 340]
quaternion_wxyz = [0.7071, 0.7071, 0, 0]
[skins.realtime]
sched_fifo = 10
affinity = [0]
mlock = true
[skins.verify]
mode = "idle"
budget_ms = 20.0
nice = 5
affinity = [0]
[[skins]]
name = "hand"
port = "usb:SKIN-2"
publish = "tcp://127.0.0.1:7001"
curve_keys = "keys"
control = "ipc:///nowhere/hand/control"
[skins.pose]
translation_mm = [120, 0, 610]
rotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
"""
"""Every key that needs no other file."""


def state() -> dict[str, Any]:
    """Return what is told of two skins."""
    return {
        "format": "eitskin-robot-state", "version": 1, "pid": 4711,
        "skins": [
            {
                "name": name, "publish": f"ipc:///nowhere/{name}/f", "control": f"ipc:///nowhere/{name}/c",
                "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation_mm": [0, 1.5, 2], "state": "ready",
                "pid": 4712, "restarts": 0, "why": "",
            }
            for name in ("left-arm", "hand")
        ],
    }  # fmt: skip


def read_toml(path: Path) -> None:
    """Look at it as who runs its skins does, and as who subscribes to them."""
    commanded(path.parent, "run", "--config", str(path), "--check")
    commanded(path.parent, "run", "--config", str(path), "--check", "--json")
    _subscribe(path)


def read_state(path: Path) -> None:
    """Look at the folder as ``eitskin status --all`` and as who subscribes."""
    from eitskin.robot.described import states_of
    from eitskin_tools.commands.live.status import looked_at

    _subscribe(path.parent)
    for row in looked_at(states_of(path.parent)[:1], 0.01, None):  # nobody answers
        json.dumps(row, allow_nan=False)
        if not row["text"].isprintable():
            raise AssertionError(f"a line that a terminal could obey: {row['text']!r}")


def _subscribe(source: Path) -> None:
    from eitskin.robot.all_frames import RobotSubscription

    RobotSubscription(source, timeout_s=1.0).close()
