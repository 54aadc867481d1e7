"""Whom the viewer looks at: one skin, or all those of a robot, each where it sits."""

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
        skin: What its maps are expected to be of.
        endpoint: Where its runtime publishes; None for the default.
        name: On the robot; empty where there is one skin alone.
        pose: Where it sits on the robot.
        keys: CURVE keys.
        record_options: Of ``eitskin record``, besides.
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
    """Return all skins of a robot, in its own order.

    Args:
        config: A robot.toml, or the folder in which ``eitskin run --config`` runs.
        otherwise: The skin of those of which nothing more is known.
        keys: CURVE keys, of all skins.
        record_options: Of ``eitskin record``, besides.

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
    """Return what a skin is, as far as the files that say so are on this machine."""
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
