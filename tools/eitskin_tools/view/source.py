"""The skins that the viewer shows: one, or all of a robot with their poses."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from eitskin.errors import RobotError
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.model.bundle import load_bundle
from eitskin.robot.config import RobotSkin, SkinSettings, load_robot
from eitskin.robot.described import robot_skins
from eitskin.robot.pose import Pose
from eitskin_proto.errors import SkinError
from eitskin_proto.skin import toml
from eitskin_proto.skin.skin import Skin
from eitskin_tools.command_line import files


@dataclass(frozen=True, slots=True)
class Source:
    """One skin.

    Attributes:
        skin: Description that its maps should match.
        endpoint: Where its runtime publishes; None for the default.
        name: On the robot; empty if there is only one skin.
        pose: Of the skin on the robot.
        keys: CURVE keys.
        record_options: More options of ``eitskin record``.
    """

    skin: Skin
    endpoint: str | None = None
    name: str = ""
    pose: Pose = field(default_factory=Pose)
    keys: ClientKeys | None = None
    record_options: tuple[str, ...] = ()


def sources_of(
    config: Path, otherwise: Skin, *, keys: ClientKeys | None = None, record_options: Sequence[str] = ()
) -> tuple[Source, ...]:
    """Return all skins of a robot in its order.

    Args:
        config: A robot.toml, or the folder in which ``eitskin run --config`` runs.
        otherwise: The skin for those that are not described.
        keys: CURVE keys of all skins.
        record_options: More options of ``eitskin record``.

    Raises:
        RobotError: There are none, or the file is wrong.
        OSError: There is no such file.
    """
    found: list[tuple[RobotSkin, Skin]]
    if config.is_dir():
        found = [(one, otherwise) for one in robot_skins(config)]
    else:
        found = [(one.skin, _skin_of(one, otherwise)) for one in load_robot(config).skins]
    options = tuple(record_options)
    return tuple(Source(skin, one.publish, one.name, one.pose, keys, options) for one, skin in found)


def _skin_of(settings: SkinSettings, otherwise: Skin) -> Skin:
    """Return the description of a skin, if its files are on this machine."""
    try:
        if settings.description is not None and (
            str(settings.description) in toml.NAMED or settings.description.exists()
        ):
            return toml.load(settings.description)
        bundle = None if settings.bundle is None else files.named(settings.bundle, files.BUNDLE)
        if bundle is not None and bundle.exists():
            return load_bundle(bundle, lazily=True).skin
    except (SkinError, OSError, ValueError) as error:
        raise RobotError(f"skin {settings.name}: {error}") from error
    return otherwise
