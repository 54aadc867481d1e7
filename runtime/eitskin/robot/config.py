"""``robot.toml``: the skins of a robot, each with its port, files, endpoints and pose.

::

    format = "eitskin-robot"
    version = 1
    folder = "/run/eitskin"          # of sockets; left out: the user's runtime folder

    [[skins]]
    name = "left-arm"                # ipc://FOLDER/left-arm/frames and .../control, unless publish and control say else
    port = "/dev/serial/by-id/..."   # or usb:SERIAL
    reference = "left-flat.json"     # paths are relative to this file
    [skins.pose]
    translation_mm = [0, 120, 340]
    quaternion_wxyz = [1, 0, 0, 0]
    [skins.realtime]
    affinity = [2]

An unknown key is an error; a missing key has the default of ``eitskin run``. A subscribing program reads the same file,
of which it needs only the endpoints to exist.
"""

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, cast

from eitskin.errors import EndpointError, RobotError
from eitskin.messaging.endpoints import CONTROL, FRAMES, needs_keys, runtime_folder
from eitskin.model.bundle import shipped
from eitskin.model.manifest import SOLVERS
from eitskin.robot.pose import Pose
from eitskin_proto.fields import Fields
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import parse_toml, read_text
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.toml import NAMED
from eitskin_proto.skin.touch_kind import TouchKind

FORMAT: Final = "eitskin-robot"
VERSION: Final = 1

MAX_FILE_BYTES: Final = 64 << 10
"""Bytes of the file."""

MAX_SKINS: Final = 64
"""Skins of a robot."""

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
"""Of a skin: fit for a file's name, for a unit of systemd and for a line of a log."""

MAX_TIME: Final = 1e9
"""Of times in s and ms."""

LAST_CORE: Final = 4095

USB: Final = "usb:"
"""How the names of USB devices begin; alone it takes any."""

RESERVED_NAMES: Final = (FRAMES, CONTROL, "robot")
"""Names that mean something else in the folder."""

RESTARTS: Final = ("never", "on-failure", "always")
"""When a skin's process that ended is started again."""


@dataclass(frozen=True, slots=True)
class RobotSkin:
    """A subscriber's data about one skin.

    Attributes:
        name: Of the skin.
        publish: Endpoint of its frames.
        control: Endpoint of its control requests.
        pose: Where it sits on the robot.
    """

    name: str
    publish: str
    control: str
    pose: Pose = field(default_factory=Pose)


@dataclass(frozen=True, slots=True)
class Realtime:
    """Settings of a skin's process, as the options of ``eitskin run`` with these names."""

    sched_fifo: int | None = None
    affinity: tuple[int, ...] = ()
    mlock: bool = False


@dataclass(frozen=True, slots=True)
class Verify:
    """How frames are verified, as the options ``--verify-*`` and ``--cloud`` of ``eitskin run``."""

    mode: str = "off"
    budget_ms: float | None = None
    nice: int | None = None
    affinity: tuple[int, ...] = ()
    cloud: str = "scan"


@dataclass(frozen=True, slots=True)
class SkinSettings:
    """One skin of the file; None is the default of ``eitskin run``."""

    skin: RobotSkin
    port: str
    baud: int | None = None
    bundle: Path | None = None
    description: Path | None = None
    """``skin`` in the file."""
    touches: TouchKind | None = None
    reference: Path | None = None
    reference_frames: int | None = None
    curve_keys: Path | None = None
    solver: str | None = None
    budget_ms: float | None = None
    every_map: bool = False
    idle_after_s: float | None = None
    exclude_electrodes: tuple[int, ...] = ()
    compensate_drift: bool | None = None
    reconnect_s: float | None = None
    restart: str = "never"
    realtime: Realtime = field(default_factory=Realtime)
    verify: Verify = field(default_factory=Verify)

    @property
    def name(self) -> str:
        """Of the skin."""
        return self.skin.name


@dataclass(frozen=True, slots=True)
class Robot:
    """The content of a robot.toml.

    Attributes:
        folder: Default folder of the sockets and of the skins' state.
        skins: In the file's order.
    """

    folder: Path
    skins: tuple[SkinSettings, ...]


def load_robot(path: str | Path) -> Robot:
    """Return the content of a robot.toml, without checking that the files it names exist.

    Raises:
        RobotError: The content is wrong: not TOML, an unknown key, a wrong value, two skins with one name, port or
            endpoint; the text names file, skin and key.
        OSError: There is no such file.
    """
    where = Path(path)
    try:
        return _robot(Fields(parse_toml(read_text(where, MAX_FILE_BYTES)), ""), where.absolute().parent)
    except ValueError as error:
        text = str(error)
        raise RobotError(text if text.startswith(str(where)) else f"{where}: {text}") from error


def _robot(content: Fields, beside: Path) -> Robot:
    content.check_format(FORMAT, VERSION, "a robot's list of skins")
    folder = _path(content, "folder", beside) or runtime_folder()
    listed = content.entries("skins", least=1, most=MAX_SKINS, of="tables [[skins]]")
    content.close()
    skins = tuple(_skin(listed.table(place), folder, beside) for place in listed)
    _check_distinct(skins)
    return Robot(folder, skins)


def _skin(table: Fields, folder: Path, beside: Path) -> SkinSettings:
    name = table.text("name")
    if NAME.fullmatch(name) is None or name.lower() in RESERVED_NAMES:
        raise table.wrong(
            "name",
            f"letters, digits, - and _, at most 32, not beginning with - or _, and none of "
            f"{', '.join(RESERVED_NAMES)}: it names a folder",
        )
    table.where = f"skin {name}"
    curve_keys = _path(table, "curve_keys", beside)
    reference = _path(table, "reference", beside)
    found = SkinSettings(
        skin=RobotSkin(
            name,
            _endpoint(table, "publish", folder / name / FRAMES, keys=curve_keys is not None),
            _endpoint(table, "control", folder / name / CONTROL, keys=curve_keys is not None),
            _pose(table.table("pose")),
        ),
        port=table.text("port", what="a serial port's path or usb:SERIAL"),
        baud=table.whole("baud", None, low=300, high=1 << 30),
        bundle=_named(table.text("bundle", None), shipped(), beside),
        description=_named(table.text("skin", None), NAMED, beside),
        touches=cast(TouchKind | None, table.choice("touches", ("lower", "raise"), None)),
        reference=reference,
        reference_frames=table.whole("reference_frames", None, low=2, high=10_000),
        curve_keys=curve_keys,
        solver=table.choice("solver", SOLVERS, None),
        budget_ms=table.number("budget_ms", None, above=0.0, high=MAX_TIME),
        every_map=table.truth("every_map", False),
        idle_after_s=table.number("idle_after_s", None, above=0.0, high=MAX_TIME),
        exclude_electrodes=table.wholes("exclude_electrodes", (), high=N_ELECTRODES - 1),
        compensate_drift=table.truth("compensate_drift", None),
        reconnect_s=table.number("reconnect_s", None, above=0.0, high=MAX_TIME),
        restart=table.choice("restart", RESTARTS, "never"),
        realtime=_realtime(table.table("realtime")),
        verify=_verify(table.table("verify")),
    )
    table.close()
    if reference is not None and found.reference_frames is not None:
        raise ValueError(
            f"skin {name} has reference and reference_frames, expected one of them: a stored reference captures no "
            "frames"
        )
    if found.restart != "never" and reference is None:
        raise ValueError(
            f"skin {name} restart is {found.restart!r} without a reference: a restart cannot know that the sheet lies "
            "flat and untouched; capture one with 'eitskin reference' and name it"
        )
    return found


def _pose(table: Fields) -> Pose:
    """Return where a skin sits; the robot's origin where its table is empty."""
    ways = ("rotation", "quaternion_wxyz", "quaternion_xyzw")
    given: dict[str, Any] = {key: value for key in ways if (value := table.value(key, None)) is not None}
    translation = table.value("translation_mm", [0.0, 0.0, 0.0])
    table.close()
    if len(given) > 1:
        raise ValueError(f"{table.where} has {' and '.join(given)}, expected one of them")
    if "quaternion_xyzw" in given:
        last = given.pop("quaternion_xyzw")
        given["quaternion_wxyz"] = [last[3], *last[:3]] if isinstance(last, list) and len(last) == 4 else last
    try:
        return Pose.of(**given, translation_mm=translation)
    except ValueError as error:
        raise ValueError(f"{table.where} {error}") from error


def _realtime(table: Fields) -> Realtime:
    found = Realtime(
        table.whole("sched_fifo", None, low=1, high=99),
        table.wholes("affinity", (), high=LAST_CORE),
        table.truth("mlock", False),
    )
    table.close()
    return found


def _verify(table: Fields) -> Verify:
    found = Verify(
        table.choice("mode", ("off", "idle", "always"), "off"),
        table.number("budget_ms", None, above=0.0, high=MAX_TIME),
        table.whole("nice", None, high=19),
        table.wholes("affinity", (), high=LAST_CORE),
        table.choice("cloud", ("scan", "fitted", "flat"), "scan"),
    )
    table.close()
    if found.mode == "off" and found != Verify():
        raise ValueError(f'{table.where} has mode off with other keys; expected mode = "idle" or "always"')
    return found


def _path(table: Fields, key: str, beside: Path) -> Path | None:
    """Return a path; a relative one is relative to the file's folder."""
    value = table.text(key, None)
    return None if value is None else beside / Path(value).expanduser()


def _named(value: str | None, shipped: tuple[str, ...], beside: Path) -> Path | None:
    return None if value is None else Path(value) if value in shipped else beside / Path(value).expanduser()


def _endpoint(table: Fields, key: str, default: Path, *, keys: bool) -> str:
    """Return an endpoint that can be bound and that a subscriber can know."""
    endpoint = table.text(key, None) or f"ipc://{default}"
    try:
        if needs_keys(endpoint) and not keys:
            raise ValueError(
                f"{table.where} {key} is {endpoint}, which other machines or users can reach: add curve_keys"
            )
    except EndpointError as error:
        raise ValueError(f"{table.where} {key}: {error}") from error
    if endpoint.endswith(":*"):
        raise ValueError(f"{table.where} {key} is {quoted(endpoint)}, expected a fixed port number")
    return endpoint


def _check_distinct(skins: tuple[SkinSettings, ...]) -> None:
    """Raise ValueError where two skins would get into each other's way."""
    seen: dict[tuple[str, str], str] = {}
    for one in skins:
        port = one.port if one.port.startswith(USB) else os.path.realpath(one.port)
        own = (
            ("name", one.name.lower()), ("port", port), ("endpoint", one.skin.publish), ("endpoint", one.skin.control),
        )  # fmt: skip
        for key in own:
            if key in seen:
                raise ValueError(f"skins {seen[key]} and {one.name} share the {key[0]} {key[1]}; expected one each")
            seen[key] = one.name
    usb = [one for one in skins if one.port.startswith(USB)]
    if len(usb) > 1 and (anyone := next((one.name for one in usb if one.port == USB), None)):
        raise ValueError(
            f"skin {anyone} port is {USB!r}, which takes any USB skin; expected usb:SERIAL, as there are several"
        )
