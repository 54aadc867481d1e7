"""robot.json: what is written is read again, and what is not ours is refused in a line."""

import json
import stat

import pytest

from eitskin.errors import RobotError
from eitskin.robot.config import RobotSkin
from eitskin.robot.described import FILE, ProcessState, read_states, robot_skins, write_states
from eitskin.robot.pose import Pose

POSE = Pose.of(quaternion_wxyz=[0.5, 0.5, 0.5, 0.5], translation_mm=[1.0, -2.0, 3.5])
STATES = (
    ProcessState(RobotSkin("left", "ipc:///l/frames", "ipc:///l/control", POSE), "ready", 17, 2, "ended by signal 9"),
    ProcessState(RobotSkin("right", "ipc:///r/frames", "ipc:///r/control"), "failed", 0, 0, "no port"),
)


def test_what_is_written_is_read_again(tmp_path):
    write_states(tmp_path, 16, STATES)
    assert read_states(tmp_path) == STATES
    assert robot_skins(tmp_path) == tuple(one.skin for one in STATES)
    assert stat.S_IMODE((tmp_path / FILE).stat().st_mode) & 0o077 == 0


@pytest.mark.parametrize(
    "change",
    [
        lambda found: found.pop("skins"), lambda found: found.update(version=2), lambda found: found.update(skins=[]),
        lambda found: found.update(skins=[5]), lambda found: found["skins"][0].update(name="../x"),
        lambda found: found["skins"][0].update(rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        lambda found: found["skins"][0].update(publish=5), lambda found: found["skins"][0].update(pid="x"),
        lambda found: found["skins"][0].update(publish="http://x"), lambda found: found["skins"][0].update(state="odd"),
    ],
)  # fmt: skip
def test_a_file_that_is_not_ours_is_refused_in_a_line(tmp_path, change):
    write_states(tmp_path, 16, STATES)
    found = json.loads((tmp_path / FILE).read_text())
    change(found)
    (tmp_path / FILE).write_text(json.dumps(found))
    with pytest.raises(RobotError, match="does not have this release's format") as raised:
        read_states(tmp_path)
    assert "\n" not in str(raised.value)
