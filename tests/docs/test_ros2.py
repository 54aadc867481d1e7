"""The package of ``tools/ros2`` in an environment of its own with the rclpy of the package index, without eitskin."""

import os
import re
import subprocess
import sys
import time

import numpy as np
import pytest

import eitskin
from eitskin.messaging.frame_message import FramePacker
from eitskin.messaging.publish import Publisher
from eitskin.touches.touch import LAYOUT
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER

from .conftest import Process
from .markdown import ROOT, code_blocks
from .test_tour import PATIENCE_S

pytestmark = [pytest.mark.slow, pytest.mark.process]

PROBE = """
import sys

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger


def say(*words):
    print(*words, flush=True)


def points(message):
    kind = [(field.name, {7: "<f4", 6: "<u4"}[field.datatype]) for field in message.fields]
    return np.frombuffer(bytes(message.data), dtype=kind, count=message.width)


def touches(message):
    for point in points(message):
        x, y, z = (round(1e3 * float(point[axis]), 1) for axis in "xyz")
        say("touch", message.header.frame_id, x, y, z, float(point["nz"]), int(point["id"]))
    if not message.width:
        say("nothing touches")


def image(message):
    values = np.frombuffer(bytes(message.data), dtype="<f4").reshape(message.height, message.width)
    if values.max() > 0.5:
        say("map", message.encoding, *values.shape, *np.unravel_index(values.argmax(), values.shape))


def surface(message):
    found = points(message)
    if found["value"].max() > 0.5:
        say("surface", len(found), *(round(1e3 * float(found[axis].min()), 1) for axis in "xyz"))


def diagnostics(message):
    for status in message.status:
        say("diag", status.level[0], status.name, "-", status.message, len(status.values))


rclpy.init()
node = Node("probe")
policy = ReliabilityPolicy.RELIABLE if "reliable" in sys.argv else ReliabilityPolicy.BEST_EFFORT
quality = QoSProfile(depth=1000, reliability=policy)
node.create_subscription(PointCloud2, "/eitskin/touches", touches, quality)
node.create_subscription(DiagnosticArray, "/diagnostics", diagnostics, 10)
if "all" in sys.argv:
    node.create_subscription(Image, "/eitskin/map", image, quality)
    node.create_subscription(PointCloud2, "/eitskin/surface", surface, quality)
    capture = node.create_client(Trigger, "/eitskin/capture_reference")
    exclude = node.create_client(SetParameters, "/eitskin/set_parameters")
    capture.wait_for_service()
    exclude.wait_for_service()
    for electrodes in ([3], [1, 2, 3, 4, 5], []):
        parameter = Parameter("excluded", Parameter.Type.INTEGER_ARRAY, electrodes).to_parameter_msg()
        done = exclude.call_async(SetParameters.Request(parameters=[parameter]))
        rclpy.spin_until_future_complete(node, done)
        say("excluded", electrodes, done.result().results[0].successful, done.result().results[0].reason)
    done = capture.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, done)
    say("captured", done.result().success, done.result().message)
rclpy.spin(node)
"""


@pytest.fixture(scope="module")
def ros(tmp_path_factory):
    """The folder of an environment's programs, made as the page says; skipped where the index has none for it."""
    folder = tmp_path_factory.mktemp("ros")
    subprocess.run([sys.executable, "-m", "venv", folder / "v"], check=True, timeout=PATIENCE_S)
    page = "\n".join(code_blocks(ROOT / "docs/ros2.md", "text"))
    words = re.search(r"^pip install (ros-rclpy.*)$", page, re.MULTILINE).group(1).split()
    pip = [folder / "v/bin/python", "-m", "pip", "--disable-pip-version-check", "--quiet", "install", *words]
    done = subprocess.run(pip, cwd=ROOT, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    if re.search(r"No matching distribution|Connection|Temporary failure|Max retries", done.stderr):
        pytest.skip(f"no package index: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    return folder / "v/bin"


@pytest.fixture
def run(ros, tmp_path):
    """Return a function that runs a program in a graph of its own."""
    (tmp_path / "probe.py").write_text(PROBE)
    started = []
    environment = {
        "ROS_DOMAIN_ID": str(os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(tmp_path), "PYTHONPATH": "",
    }  # fmt: skip

    def start(*words, **parameters):
        given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        words = [*words, *(["--ros-args", *given] if given else [])]
        started.append(Process(*words, folder=tmp_path, python=ros / "python", **environment))
        return started[-1]

    yield start
    for process in started:
        process.end()


def test_a_runtime_is_on_standard_messages_and_takes_requests(run, ros, runtime):
    away = np.array([2000.0, 0.0, 250.0])[:, None, None]
    eitskin.send_cloud(runtime.control, flat_cloud() + away)  # whatever others of these tests have sent
    run(ros / "skin", endpoint=runtime.frames, control=runtime.control, frame_id="forearm", blind_s=30.0)
    probe = run("probe.py", "all")
    assert "True" in probe.until("excluded [3]")
    assert "False" in probe.until("excluded [1, 2, 3, 4, 5]")
    assert "True" in probe.until("excluded []")
    assert re.search("True .*median_spread|False .*(touched|flat|moves)", probe.until("captured"))
    assert probe.until("nothing touches")
    _, frame_id, x, y, z, facing, number = probe.until("touch forearm").split()
    assert 2000.0 < float(x) < 2150.0
    assert 0.0 < float(y) < 100.0
    assert (frame_id, float(z), float(facing), int(number) > 0) == ("forearm", 250.0, 1.0, True)
    _, encoding, rows, columns, row, column = probe.until("map ").split()
    assert (encoding, rows, columns, int(row) < 30, int(column) < 45) == ("32FC1", "30", "45", True, True)
    assert probe.until("surface ").split()[1:] == ["1350", "2001.7", "1.7", "250.0"]
    assert "frames come 9" in probe.until("diag 0 eitskin: stream")
    robot = run(ROOT / "docs/examples/ros2_stop.py")
    robot.until("go ")
    assert "stop " in robot.until(" touched ")  # on a busy machine it may be blind before


@pytest.mark.parametrize("reliability", ["best_effort", "reliable"])
def test_every_frame_arrives_at_200_a_second_and_silence_or_other_frames_are_blind(run, ros, tmp_path, reliability):
    packer = FramePacker(configuration="paper/1", bundle="b", serial_number="s", run="r", shape=PAPER.grid.shape)
    packer.put_texts("vd2t", (), ())
    publisher = Publisher(f"ipc://{tmp_path}/frames")
    sent = 0

    def send(number, age_us=1000, old=b"\xa1v\x02", new=b"\xa1v\x02"):
        nonlocal sent
        sent += 1
        for name, value in (("n", sent), ("age_us", age_us), ("publish", time.perf_counter_ns())):
            packer.put(name, value)
        packer.put_touches((LAYOUT.pack(number, 0, *[1.0] * 24), b"", 0))
        publisher.update()
        publisher.send_beside(packer.touch_message().replace(old, new))
        time.sleep(0.005)

    def heard():
        return [int(line.split()[-1]) for line in probe.said if line.startswith("touch")]

    def until(wanted, **options):
        end_s = time.monotonic() + PATIENCE_S
        while not (found := [line for line in probe.said if wanted in line]):
            assert time.monotonic() < end_s, probe.said[-5:]
            send(1, **options)
        return found[0]

    node = run(ros / "skin", endpoint=publisher.endpoint, reliability=reliability)
    probe = run("probe.py", reliability)
    probe.listen()
    try:
        until("touch skin")
        for number in range(1000, 1600):
            send(number)
        node.until("blind: no frame from")
        wait_for(probe, "diag 2 eitskin: stream - blind: no frame from")
        numbers = [number for number in heard() if number >= 1000]
        assert numbers == sorted(set(numbers))
        assert len(numbers) >= (600 if reliability == "reliable" else 300)
        until("frames of version 9; this package reads 2", new=b"\xa1v\x09")
        before = len(heard())
        until("s old, more than 0.5 s", age_us=10**6)
        assert len(heard()) == before
    finally:
        publisher.close()


def wait_for(probe, wanted):
    end_s = time.monotonic() + PATIENCE_S
    while not any(wanted in line for line in probe.said):
        assert time.monotonic() < end_s, probe.said[-5:]
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"frame_id": "/skin"}, "expected a name without a slash before it"),
        ({"endpoint": "tcp://127.0.0.1:9"}, "with the parameters server_key and client_key"),
        ({"reliability": "often"}, "expected best_effort or reliable"),
    ],
)
def test_parameters_that_make_no_sense_are_one_line(run, ros, parameters, said):
    assert said in run(ros / "skin", **parameters).until("[ERROR]")
