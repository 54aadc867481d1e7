"""``robot.toml``: the skins of a robot, each with its port, its files, where it publishes and where it sits.

::

    format = "eitskin-robot"
    version = 1
    folder = "/run/eitskin"          # of sockets; left out: the runtime folder of whoever runs it

    [[skins]]
    name = "left-arm"                # ipc://FOLDER/left-arm/frames and .../control, unless publish and control say else
    port = "/dev/serial/by-id/..."   # or usb:SERIAL
    reference = "left-flat.json"     # paths are relative to this file
    [skins.pose]
    translation_mm = [0, 120, 340]
    quaternion_wxyz = [1, 0, 0, 0]
    [skins.realtime]
    affinity = [2]

An unknown key is an error; what is left out has the default of ``eitskin run``. A program that subscribes reads the
same file: nothing that it names has to be there but the endpoints.
"""

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from eitskin.errors import EndpointError, RobotError
from eitskin.messaging.endpoints import CONTROL, FRAMES, needs_keys, runtime_folder
from eitskin.robot.parts import Realtime, Verify, pose_of, realtime_of, verify_of
from eitskin.robot.pose import Pose
from eitskin.robot.values import Table
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import parse_toml, read_text

FORMAT: Final = "eitskin-robot"
VERSION: Final = 1

LARGEST: Final = 64 << 10
"""Bytes of the file."""

MOST: Final = 64
"""Skins of a robot."""

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
"""Of a skin: fit for a file's name, for a unit of systemd and for a line of a log."""

USB: Final = "usb:"
"""How the names of USB devices begin; alone it takes any."""

TAKEN: Final = (FRAMES, CONTROL, "robot")
"""Names that mean something else in the folder."""

KEYS: Final = (
    "name", "port", "baud", "bundle", "skin", "touches", "reference", "reference_frames", "curve_keys", "publish",
    "control", "solver", "budget_ms", "every_map", "idle_after_s", "exclude_electrodes", "compensate_drift",
    "reconnect_s", "restart", "pose", "realtime", "verify",
)  # fmt: skip
"""Of one skin."""

RESTARTS: Final = ("never", "on-failure", "always")
"""When a skin's process that ended is started again."""

SHIPPED_SKINS: Final = ("paper", "hydrogel", "lab")
SHIPPED_BUNDLES: Final = ("free", "press", "units")
"""Descriptions and bundles that are named and not looked for."""


@dataclass(frozen=True, slots=True)
class RobotSkin:
    """What a subscriber needs of one skin.

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
class SkinSettings:
    """One skin of the file; None is the default of ``eitskin run``."""

    skin: RobotSkin
    port: str
    baud: int | None = None
    bundle: Path | None = None
    description: Path | None = None
    """``skin`` in the file."""
    touches: str | None = None
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
    """The whole file.

    Attributes:
        folder: Where sockets lie by default, and what is known of the skins while they run.
        skins: In the file's order.
    """

    folder: Path
    skins: tuple[SkinSettings, ...]


def load_robot(path: str | Path) -> Robot:
    """Return what a robot.toml says; whether its files are there is not looked at.

    Raises:
        RobotError: The content is wrong: not TOML, an unknown key, a wrong value, two skins with one name, port or
            endpoint; the text names file, skin and key.
        OSError: There is no such file.
    """
    where = Path(path)
    try:
        return _robot(Table(parse_toml(read_text(where, LARGEST)), "the head of the file"), where.absolute().parent)
    except ValueError as error:
        text = str(error)
        raise RobotError(text if text.startswith(str(where)) else f"{where}: {text}") from error


def _robot(table: Table, beside: Path) -> Robot:
    if table.text("format") != FORMAT or table.whole("version", 0, 1 << 20) != VERSION:
        raise ValueError(f"expected format = {FORMAT!r} and version = {VERSION}: is it a robot's list of skins?")
    stated = table.path("folder", beside)
    listed = table.take("skins")
    table.end()
    if not isinstance(listed, list) or not listed or not all(isinstance(one, dict) for one in listed):
        raise ValueError(f"skins is {quoted(listed)}, expected one table [[skins]] for each skin, and at least one")
    if len(listed) > MOST:
        raise ValueError(f"there are {len(listed)} skins, expected at most {MOST}")
    folder = runtime_folder() if stated is None else stated
    skins = tuple(_skin(Table(one, f"skins[{index}]"), folder, beside) for index, one in enumerate(listed))
    _check_distinct(skins)
    return Robot(folder, skins)


def _skin(table: Table, folder: Path, beside: Path) -> SkinSettings:
    name = table.text("name")
    if name is not None and NAME.fullmatch(name) is not None:
        table.where = f"skin {name}"
    table.only(KEYS)
    if name is None or NAME.fullmatch(name) is None or name.lower() in TAKEN:
        found = "has no name" if name is None else f"name is {quoted(name)}"
        raise ValueError(
            f"{table.where} {found}, expected letters, digits, - and _, at most 32, not beginning with - or _, and "
            f"none of {', '.join(TAKEN)}: it names a folder"
        )
    port = table.text("port")
    if port is None:
        raise ValueError(f"skin {name} has no port, expected a serial port's path or usb:SERIAL")
    curve_keys = table.path("curve_keys", beside)
    publish = _endpoint(table, "publish", folder / name / FRAMES, keys=curve_keys is not None)
    control = _endpoint(table, "control", folder / name / CONTROL, keys=curve_keys is not None)
    restart = table.one_of("restart", RESTARTS) or "never"
    reference = table.path("reference", beside)
    reference_frames = table.whole("reference_frames", 2, 10_000)
    if reference is not None and reference_frames is not None:
        raise ValueError(f"skin {name} has a reference, so reference_frames does nothing: leave one of them out")
    if restart != "never" and reference is None:
        raise ValueError(
            f"skin {name} restart is {restart!r} without a reference: who starts again by itself cannot know that the "
            "sheet is flat and untouched; capture one with 'eitskin reference', and name it"
        )
    return SkinSettings(
        skin=RobotSkin(name, publish, control, pose_of(table)),
        port=port,
        baud=table.whole("baud", 300, 1 << 30),
        bundle=_named(table.text("bundle"), SHIPPED_BUNDLES, beside),
        description=_named(table.text("skin"), SHIPPED_SKINS, beside),
        touches=table.one_of("touches", ("lower", "raise")),
        reference=reference,
        reference_frames=reference_frames,
        curve_keys=curve_keys,
        solver=table.one_of("solver", ("vd2t", "vd2t-int8", "vd2t-small", "tikhonov")),
        budget_ms=table.number("budget_ms"),
        every_map=table.truth("every_map") or False,
        idle_after_s=table.number("idle_after_s"),
        exclude_electrodes=table.wholes("exclude_electrodes", 15),
        compensate_drift=table.truth("compensate_drift"),
        reconnect_s=table.number("reconnect_s"),
        restart=restart,
        realtime=realtime_of(table),
        verify=verify_of(table),
    )


def _named(value: str | None, shipped: tuple[str, ...], beside: Path) -> Path | None:
    return None if value is None else Path(value) if value in shipped else beside / Path(value).expanduser()


def _endpoint(table: Table, key: str, default: Path, *, keys: bool) -> str:
    """Return an endpoint that can be bound and that a subscriber can know."""
    endpoint = table.text(key) or f"ipc://{default}"
    try:
        if needs_keys(endpoint, control=key == "control") and not keys:
            raise ValueError(f"{table.where} {key} is {endpoint}, which others may reach: it needs curve_keys")
    except EndpointError as error:
        raise ValueError(f"{table.where} {key}: {error}") from error
    if endpoint.endswith(":*"):
        raise ValueError(f"{table.where} {key} is {quoted(endpoint)}, expected a port that subscribers can know")
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
                raise ValueError(f"skins {seen[key]} and {one.name} have one {key[0]}, {key[1]}; expected one each")
            seen[key] = one.name
    usb = [one for one in skins if one.port.startswith(USB)]
    if len(usb) > 1 and (anyone := next((one.name for one in usb if one.port == USB), None)):
        raise ValueError(f"skin {anyone} port is {USB!r}, which takes any; expected usb:SERIAL beside other USB skins")
