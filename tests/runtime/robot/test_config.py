"""robot.toml: what a good one says, and one line for each bad one."""

import pytest

from eitskin.errors import RobotError
from eitskin.model.bundle import shipped
from eitskin.robot.config import load_robot
from eitskin.robot.described import robot_skins

HEAD = 'format = "eitskin-robot"\nversion = 1\n'


@pytest.fixture
def robot(tmp_path):
    """Return what writes a robot.toml and loads it."""

    def load(text, head=HEAD + 'folder = "sockets"\n'):
        path = tmp_path / "robot.toml"
        path.write_text(head + text)
        return load_robot(path)

    return load


def skin(name="left", port="/dev/ttyACM0", more=""):
    return f'[[skins]]\nname = "{name}"\nport = "{port}"\n{more}\n'


def test_what_is_shipped_is_named_and_everything_else_lies_beside_the_file(robot, tmp_path):
    for name in shipped():
        assert str(robot(skin(more=f'bundle = "{name}"')).skins[0].bundle) == name
    assert robot(skin(more='bundle = "./press"')).skins[0].bundle == tmp_path / "press"


def test_a_whole_file_is_read(robot, tmp_path):
    more = """
    bundle = "left.eitskin"
    skin = "hydrogel"
    reference = "left.json"
    touches = "lower"
    solver = "vd2t-int8"
    budget_ms = 5
    every_map = true
    idle_after_s = 2.5
    exclude_electrodes = [3, 7]
    compensate_drift = false
    reconnect_s = 60
    restart = "on-failure"
    [skins.pose]
    quaternion_xyzw = [0, 0, 1, 0]
    translation_mm = [1, 2, 3]
    [skins.realtime]
    sched_fifo = 50
    affinity = [0, 1]
    mlock = true
    """
    found = robot(
        skin(more=more) + skin("right", "usb:SKIN-2", 'publish = "tcp://127.0.0.1:5555"\ncurve_keys = "keys"')
    )
    left, right = found.skins
    assert left.skin.publish == f"ipc://{tmp_path}/sockets/left/frames"
    assert left.skin.control == f"ipc://{tmp_path}/sockets/left/control"
    assert (left.bundle, left.reference) == (tmp_path / "left.eitskin", tmp_path / "left.json")
    assert str(left.description) == "hydrogel"
    assert left.skin.pose.place([1, 0, 0]).tolist() == pytest.approx([0, 2, 3])  # half a turn about z
    assert (left.realtime.affinity, left.realtime.sched_fifo, left.exclude_electrodes) == ((0, 1), 50, (3, 7))
    assert (right.skin.publish, right.restart, right.compensate_drift) == ("tcp://127.0.0.1:5555", "never", None)


def test_skins_are_listed_by_name_endpoint_and_pose(robot, tmp_path):
    robot(skin("a", "/dev/a") + skin("b", "/dev/b", "pose = {translation_mm = [0, 0, 9]}"))
    a, b = robot_skins(tmp_path / "robot.toml")
    assert (a.name, b.name) == ("a", "b")
    assert b.pose.translation_mm.tolist() == [0.0, 0.0, 9.0]
    assert robot_skins(str(tmp_path / "robot.toml"))[0].publish == a.publish


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"lacks skins, expected a list of 1 to 64 tables \[\[skins\]\]"),
        ("skins = []", "expected a list of 1 to 64 tables"),
        (skin() + skin("right"), "skins left and right share the port /dev/ttyACM0"),
        (skin() + skin("left", "/dev/b"), "skins left and left share the name left"),
        (
            skin(more='publish = "ipc:///x"') + skin("b", "/dev/b", 'control = "ipc:///x"'),
            "left and b share the endpoint",
        ),
        (skin(more='publish = "ipc:///x"\ncontrol = "ipc:///x"'), "share the endpoint ipc:///x"),
        (skin(more='[skins.verify]\nmode = "often"'), "expected one of off, idle, always"),
        (skin(more="[skins.verify]\nnice = 3"), "has mode off with other keys"),
        (skin(port="usb:") + skin("b", "usb:7"), "skin left port is 'usb:', which takes any"),
        (skin(name="a/b"), "expected letters, digits"),
        (skin(name="frames"), "none of frames, control, robot"),
        (skin(name="a\\nb"), "expected a text of at most"),
        ('[[skins]]\nname = "x"', "skin x lacks port, expected a serial port's path"),
        ('[[skins]]\nname = "x"\nprot = "y"', r"skin x lacks port, .*; is it meant by 'prot'\?"),
        (skin(more="bundel = 3"), "unknown key 'bundel' in skin left; did you mean 'bundle'"),
        (skin(more="pose.rotation = [[1,0,0],[0,1,0],[0,0,-1]]"), "skin left pose rotation .* it is a mirror"),
        (skin(more="pose.rotation = [[1,0,0],[0,1,0],[0,1,1]]"), "skin left pose rotation .* not a rotation"),
        (skin(more="pose.quaternion_wxyz = [1,0,0,0]\npose.quaternion_xyzw = [0,0,0,1]"), "expected one of them"),
        (skin(more="restart = 'always'"), "restart is 'always' without a reference"),
        (
            skin(more="reference = 'r'\nreference_frames = 5"),
            "has reference and reference_frames, expected one of them",
        ),
        (skin(more="restart = 'sometimes'"), "expected one of never, on-failure, always"),
        (skin(more="budget_ms = -1"), "skin left budget_ms is -1, expected a number above 0"),
        (
            skin(more="exclude_electrodes = [16]"),
            r"electrodes\[0\] is 16, expected a whole number from 0 to 15",
        ),
        (skin(more='publish = "tcp://127.0.0.1:5555"'), "which other machines or users can reach: add curve_keys"),
        (skin(more='publish = "tcp://127.0.0.1:*"\ncurve_keys = "keys"'), "expected a fixed port number"),
        (skin(more='publish = "left"'), "skin left publish: endpoint 'left': expected ipc:"),
        (skin(more=f'publish = "ipc:///{"x" * 100}"'), "more than 100 bytes"),
        ("".join(skin(f"s{k}", f"/dev/{k}") for k in range(65)), "skins is a list of 65, expected a list of 1 to 64"),
        ("version = 1", "not a TOML file"),
    ],
)
def test_a_bad_file_is_one_line_that_names_it(robot, tmp_path, text, said):
    with pytest.raises(RobotError, match=said) as raised:
        robot(text)
    assert str(raised.value).startswith(f"{tmp_path}/robot.toml")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "head", ["", 'format = "eitskin-skin"\nversion = 1\n', 'format = "eitskin-robot"\nversion = 2\n']
)
def test_a_file_of_another_kind_or_version_is_refused(robot, head):
    with pytest.raises(RobotError, match="is it a robot's list of skins"):
        robot(skin(), head)


def test_a_file_that_is_missing_too_long_or_no_file_is_said(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_robot(tmp_path / "none.toml")
    (tmp_path / "long.toml").write_text("#" * (1 << 17))
    with pytest.raises(RobotError, match="longer than"):
        load_robot(tmp_path / "long.toml")
