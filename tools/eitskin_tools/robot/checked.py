"""What of a robot.toml can be wrong before anything is started: files that are missing, bundles of another skin."""

import os
from pathlib import Path

from eitskin.errors import RobotError
from eitskin.pipeline.latency_budget import MOST_MS
from eitskin.robot.config import Robot, SkinSettings
from eitskin_proto.errors import SkinError
from eitskin_tools.command_line import files
from eitskin_tools.command_line.touches import WAYS
from eitskin_tools.console.run_report import doubts


def check(robot: Robot) -> list[tuple[str, str]]:
    """Look at every file that is named, before any process is started; no port is opened.

    Returns:
        What each skin would warn of at its start: its name, and the line.

    Raises:
        RobotError: One is missing or cannot be used; the text names the skin.
    """
    available = os.sched_getaffinity(0)
    warnings: list[tuple[str, str]] = []
    for one in robot.skins:
        try:
            warnings += [(one.name, line) for line in _check_files(one)]
            for key, cpus in (("affinity", one.realtime.affinity), ("verify.affinity", one.verify.affinity)):
                if missing := sorted(set(cpus) - available):
                    raise RobotError(f"{key}: CPU {missing}, expected some of {sorted(available)}")
            for key, budget_ms in (("budget_ms", one.budget_ms), ("verify.budget_ms", one.verify.budget_ms)):
                if budget_ms is not None and budget_ms > MOST_MS:
                    raise RobotError(f"{key} is {budget_ms:g}, expected at most {MOST_MS:.0f}")
        except (SkinError, ValueError, OSError) as error:
            raise RobotError(f"skin {one.name}: {error}") from error
    return warnings


def _check_files(settings: SkinSettings) -> list[str]:
    from eitskin.messaging.curve_keys import load_server_keys
    from eitskin.model.skin_in_use import bundle_and_skin, knowing
    from eitskin.reference import captured
    from eitskin_proto.skin import toml

    bundle_path = _there("bundle", settings.bundle, files.BUNDLE)
    description_path = _there("skin", settings.description, files.SKIN)
    _there("reference", settings.reference, files.REFERENCE)
    _there("curve_keys", settings.curve_keys, files.KEYS)
    description = None if description_path is None else toml.load(description_path)
    bundle = bundle_path if settings.touches is None else knowing(WAYS[settings.touches], bundle_path)
    chosen, used = bundle_and_skin(bundle, description)
    captured.taken(settings.reference, used)
    if settings.curve_keys is not None:
        load_server_keys(settings.curve_keys)
    return doubts(chosen, used)


def _there(key: str, given: Path | None, kind: files.Kind) -> Path | None:
    """Return the path of what a key names; None where it is left out."""
    try:
        return None if given is None else files.find(given, kind)
    except files.MissingFileError as error:
        raise RobotError(f"{key}: {error}") from error


def make_folders(robot: Robot) -> None:
    """Make the folder of the robot and one for each skin whose sockets lie there, for this user alone.

    Raises:
        RobotError: One cannot be made, or belongs to somebody else.
    """
    endpoints = [where for one in robot.skins for where in (one.skin.publish, one.skin.control)]
    homes = [Path(where.removeprefix("ipc://")).parent for where in endpoints if where.startswith("ipc://")]
    for folder in [robot.folder, *dict.fromkeys(path for path in homes if path.parent == robot.folder)]:
        try:
            folder.mkdir(mode=0o700, parents=folder == robot.folder, exist_ok=True)
        except OSError as error:
            raise RobotError(
                f"folder {folder} cannot be made: {error.strerror}; state another with folder = ..., or make it for "
                "this user"
            ) from error
        found = folder.stat()
        if found.st_uid != os.getuid() or found.st_mode & 0o022:
            raise RobotError(f"folder {folder} is not this user's alone to write; make it so, or state another")
