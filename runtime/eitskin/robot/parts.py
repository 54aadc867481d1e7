"""The tables within a skin of a robot.toml: where it sits, what its process gets, how its frames are verified.

All raise ValueError where a key is unknown or a value is wrong; the text names skin, table and key.
"""

from dataclasses import dataclass
from typing import Any

from eitskin.robot.pose import Pose
from eitskin.robot.values import Table


@dataclass(frozen=True, slots=True)
class Realtime:
    """Settings of a skin's process, as the options of ``eitskin run`` with these names."""

    sched_fifo: int | None = None
    affinity: tuple[int, ...] = ()
    mlock: bool = False


@dataclass(frozen=True, slots=True)
class Verify:
    """How frames are verified, as the options ``--verify-*`` of ``eitskin run``."""

    mode: str = "off"
    budget_ms: float | None = None
    nice: int | None = None
    affinity: tuple[int, ...] = ()


def pose_of(table: Table) -> Pose:
    """Return where a skin sits, of its table ``pose``; the robot's origin where there is none."""
    inner = table.table("pose")
    if inner is None:
        return Pose()
    given: dict[str, Any] = {key: inner.take(key) for key in ("rotation", "quaternion_wxyz", "quaternion_xyzw")}
    translation = inner.take("translation_mm")
    inner.end()
    stated = [key for key, value in given.items() if value is not None]
    if len(stated) > 1:
        raise ValueError(f"{inner.where} has {' and '.join(stated)}, expected one of them")
    quaternion = given["quaternion_wxyz"]
    if isinstance(last := given["quaternion_xyzw"], list) and len(last) == 4:
        quaternion = [last[3], *last[:3]]
    elif last is not None:
        quaternion = last  # and refused with what it is
    try:
        return Pose.of(
            rotation=given["rotation"],
            quaternion_wxyz=quaternion,
            translation_mm=[0.0, 0.0, 0.0] if translation is None else translation,
        )
    except ValueError as error:
        raise ValueError(f"{inner.where} {error}") from error


def realtime_of(table: Table) -> Realtime:
    """Return the settings of a skin's table ``realtime``."""
    inner = table.table("realtime")
    if inner is None:
        return Realtime()
    found = Realtime(inner.whole("sched_fifo", 1, 99), inner.wholes("affinity", 4095), inner.truth("mlock") or False)
    inner.end()
    return found


def verify_of(table: Table) -> Verify:
    """Return the settings of a skin's table ``verify``."""
    inner = table.table("verify")
    if inner is None:
        return Verify()
    mode = inner.one_of("mode", ("off", "idle", "always")) or "off"
    found = Verify(mode, inner.number("budget_ms"), inner.whole("nice", 0, 19), inner.wholes("affinity", 4095))
    inner.end()
    if mode == "off" and found != Verify():
        raise ValueError(f'{inner.where} has mode off and more; expected mode = "idle" or "always" with it')
    return found
