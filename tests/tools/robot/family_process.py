"""The supervising process, around stand-ins of skins: ``family_process.py ROBOT.toml GRACE_S HANG_S [PROGRAM]``."""

import os
import sys
from pathlib import Path

from eitskin.robot.config import load_robot
from eitskin_tools.console.run_log import RunLog
from eitskin_tools.processes.children import Backoff
from eitskin_tools.robot.child import SkinProcess
from eitskin_tools.robot.command import make_folders
from eitskin_tools.robot.supervise import RobotLog, SkinSupervisor
from eitskin_tools.service.supervisor import Supervisor

robot = load_robot(sys.argv[1])
make_folders(robot)
program = sys.argv[4:] or (sys.executable, "-S", str(Path(__file__).with_name("skin_script.py")))
skins = [SkinProcess(one, Backoff(0.05, 0.4, 60.0), (), program, float(sys.argv[3])) for one in robot.skins]
log = RobotLog(RunLog(sys.stderr, "json"))
sys.exit(SkinSupervisor(robot.folder, skins, log, Supervisor.of(os.environ), float(sys.argv[2])).run())
