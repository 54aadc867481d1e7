"""``eitskin run --config robot.toml``: from the command line to the supervised processes."""

import argparse
import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eitskin.errors import RobotError
from eitskin_proto.errors import SkinError
from eitskin_tools.command_line import files
from eitskin_tools.command_line.parser import Parser
from eitskin_tools.console.run_log import RunLog
from eitskin_tools.errors import UsageError

if TYPE_CHECKING:
    from eitskin.robot.config import Robot, SkinSettings

CONFIG_OPTIONS: Final = ("config", "check", "seconds", "log_format", "quiet", "json")
"""Options that go with ``--config``; all others are stated for each skin in the file."""


def run_all(arguments: argparse.Namespace, add_arguments: Callable[[Parser], None]) -> int:
    """Run every skin of a robot.toml until stopped; return the exit status.

    Args:
        arguments: Of ``eitskin run``.
        add_arguments: Declares its options.

    Raises:
        UsageError: An option was given that only a single skin can have.
        RobotError: The file, or one that it names, cannot be used.
    """
    parser = Parser()
    add_arguments(parser)
    for name, default in vars(parser.parse_args([])).items():
        if name not in CONFIG_OPTIONS and getattr(arguments, name) != default:
            raise UsageError(
                f"--{name.replace('_', '-')} is for one skin; with --config, write it into {arguments.config}"
            )
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from eitskin.robot.config import load_robot
    from eitskin_tools.processes.children import Backoff
    from eitskin_tools.robot.child import SkinProcess
    from eitskin_tools.robot.supervise import RobotLog, SkinSupervisor
    from eitskin_tools.service.supervisor import Supervisor

    robot = load_robot(Path(arguments.config))
    warnings = check_files(robot)
    log = RobotLog(RunLog(sys.stderr, arguments.log_format, quiet=arguments.quiet))
    if arguments.check:  # else each skin says so itself
        for name, line in warnings:
            log.warn(name, line)
        return _shown(robot, as_json=arguments.json)
    make_folders(robot)
    more = ["--quiet"] if arguments.quiet else []
    more += ["--json"] if arguments.json else []
    more += [] if arguments.seconds is None else [f"--seconds={arguments.seconds}"]
    supervisor = Supervisor.of(os.environ)
    whole = robot.skins
    if arguments.seconds is not None:  # a skin that reached its end is not started again
        whole = tuple(replace(one, restart="on-failure") if one.restart == "always" else one for one in whole)
    skins = [SkinProcess(one, Backoff(), more) for one in whole]
    try:
        status = SkinSupervisor(robot.folder, skins, log, supervisor).run()
    finally:
        supervisor.close()
    if arguments.json:
        print(json.dumps({"skins": [_summary(one) for one in skins]}))
    return status


def _summary(one: Any) -> dict[str, object]:
    return {
        "name": one.settings.name, "state": one.state, "status": one.status, "restarts": one.restarts, "why": one.why,
        "summary": one.summary,
    }  # fmt: skip


def _shown(robot: Any, *, as_json: bool) -> int:
    """Say what would be run."""
    rows = [
        {"name": one.name, "port": one.port, "publish": one.skin.publish, "control": one.skin.control,
         "restart": one.restart, **one.skin.pose.fields()}
        for one in robot.skins
    ]  # fmt: skip
    if as_json:
        print(json.dumps({"folder": str(robot.folder), "skins": rows}))
        return 0
    for one in robot.skins:
        print(f"{one.name}: {one.port} to {one.skin.publish}, {one.skin.pose}")
    return 0


def check_files(robot: "Robot") -> list[tuple[str, str]]:
    """Look at every file that is named, before any process is started; no port is opened.

    Returns:
        What each skin would warn of at its start: its name, and the line.

    Raises:
        RobotError: One is missing or cannot be used; the text names the skin.
    """
    from eitskin.pipeline.latency_budget import MOST_MS

    available = os.sched_getaffinity(0)
    warnings: list[tuple[str, str]] = []
    for one in robot.skins:
        try:
            warnings += [(one.name, line) for line in _check_skin(one)]
            for key, cpus in (("affinity", one.realtime.affinity), ("verify.affinity", one.verify.affinity)):
                if missing := sorted(set(cpus) - available):
                    raise RobotError(f"{key}: CPU {missing}, expected some of {sorted(available)}")
            for key, budget_ms in (("budget_ms", one.budget_ms), ("verify.budget_ms", one.verify.budget_ms)):
                if budget_ms is not None and budget_ms > MOST_MS:
                    raise RobotError(f"{key} is {budget_ms:g}, expected at most {MOST_MS:.0f}")
        except (SkinError, ValueError, OSError) as error:
            raise RobotError(f"skin {one.name}: {error}") from error
    return warnings


def _check_skin(settings: "SkinSettings") -> list[str]:
    from eitskin.health.monitor import health_of
    from eitskin.messaging.curve_keys import load_server_keys
    from eitskin.model.skin_in_use import bundle_and_skin
    from eitskin.reference import captured
    from eitskin_proto.skin import toml
    from eitskin_tools.console.run_status import bundle_doubts

    bundle_path = _there("bundle", settings.bundle, files.BUNDLE)
    description_path = _there("skin", settings.description, files.SKIN)
    _there("reference", settings.reference, files.REFERENCE)
    _there("curve_keys", settings.curve_keys, files.KEYS)
    description = None if description_path is None else toml.load(description_path)
    chosen, used = bundle_and_skin(bundle_path, description, settings.touches)
    captured.taken(settings.reference, used)
    health_of(chosen, exclude=settings.exclude_electrodes, compensate_drift=settings.compensate_drift)
    if settings.curve_keys is not None:
        load_server_keys(settings.curve_keys)
    return bundle_doubts(chosen, used)


def _there(key: str, given: Path | None, kind: files.Kind) -> Path | None:
    """Return the path of what a key names; None where it is left out."""
    try:
        return None if given is None else files.find(given, kind)
    except files.MissingFileError as error:
        raise RobotError(f"{key}: {error}") from error


def make_folders(robot: "Robot") -> None:
    """Make the folder of the robot and one for each skin with sockets in it, for this user alone.

    Raises:
        RobotError: One cannot be made, or belongs to another user.
    """
    endpoints = [where for one in robot.skins for where in (one.skin.publish, one.skin.control)]
    homes = [Path(where.removeprefix("ipc://")).parent for where in endpoints if where.startswith("ipc://")]
    for folder in [robot.folder, *dict.fromkeys(path for path in homes if path.parent == robot.folder)]:
        try:
            folder.mkdir(mode=0o700, parents=folder == robot.folder, exist_ok=True)
        except OSError as error:
            raise RobotError(
                f"folder {folder} cannot be made: {error.strerror}; name another with folder = ..., or give it to "
                "this user"
            ) from error
        found = folder.stat()
        if found.st_uid != os.getuid() or found.st_mode & 0o022:
            raise RobotError(
                f"folder {folder} can be written by other users; take that right away, or name another folder"
            )
