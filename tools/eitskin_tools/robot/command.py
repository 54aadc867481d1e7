"""``eitskin run --config robot.toml``: from the command line to the supervised processes."""

import argparse
import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from eitskin_tools.console.run_log import RunLog
from eitskin_tools.errors import UsageError

SHARED: Final = ("config", "check", "seconds", "log_format", "quiet", "json")
"""Options that go with ``--config``; all others are stated for each skin in the file."""


def run_all(arguments: argparse.Namespace, add_arguments: Callable[[argparse.ArgumentParser], None]) -> int:
    """Run every skin of a robot.toml until told to stop; return the exit status.

    Args:
        arguments: Of ``eitskin run``.
        add_arguments: Declares its options.

    Raises:
        UsageError: An option is given that one skin alone can have.
        RobotError: The file, or one that it names, cannot be used.
    """
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    for name, default in vars(parser.parse_args([])).items():
        if name not in SHARED and getattr(arguments, name) != default:
            raise UsageError(
                f"--{name.replace('_', '-')} is of one skin, and --config of all; state it in {arguments.config}"
            )
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from eitskin.robot.config import load_robot
    from eitskin_tools.processes.pauses import Pauses
    from eitskin_tools.robot.checked import check, make_folders
    from eitskin_tools.robot.child import SkinProcess
    from eitskin_tools.robot.log import RobotLog
    from eitskin_tools.robot.supervise import Family
    from eitskin_tools.service.supervisor import Supervisor

    robot = load_robot(Path(arguments.config))
    warnings = check(robot)
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
    if arguments.seconds is not None:  # whoever came to its end is not started again
        whole = tuple(replace(one, restart="on-failure") if one.restart == "always" else one for one in whole)
    skins = [SkinProcess(one, Pauses(), more) for one in whole]
    try:
        status = Family(robot.folder, skins, log, supervisor).run()
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
