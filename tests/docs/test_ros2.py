"""The ROS 2 node of docs/examples, with the rclpy of the package index in an environment of its own."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest

import eitskin
from eitskin_proto.skin.cloud import flat_cloud

from .conftest import Process
from .markdown import ROOT
from .test_tour import PATIENCE_S

pytestmark = [pytest.mark.slow, pytest.mark.process]

PACKAGES = ("ros-rclpy==9.1.2", "ros-rmw-fastrtps-cpp==9.3.3", "ros-sensor-msgs==5.5.1")

LISTENER = """
import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image, PointCloud2


def touches(message):
    names = {field.name: (field.offset, {7: "<f4", 6: "<u4"}[field.datatype]) for field in message.fields}
    kind = {"names": list(names), "formats": [form for _, form in names.values()],
            "offsets": [at for at, _ in names.values()], "itemsize": message.point_step}
    for point in np.frombuffer(bytes(message.data), dtype=kind, count=message.width):
        x, y, z = (round(1e3 * float(point[axis]), 1) for axis in "xyz")
        print("touch", message.header.frame_id, x, y, z, float(point["nz"]), int(point["id"]), flush=True)
    if not message.width:
        print("nothing touches", flush=True)


def image(message):
    values = np.frombuffer(bytes(message.data), dtype="<f4").reshape(message.height, message.width)
    if values.max() > 0.5:
        row, column = np.unravel_index(values.argmax(), values.shape)
        print("map", message.encoding, *values.shape, row, column, flush=True)


rclpy.init()
node = Node("listener")
node.create_subscription(PointCloud2, "/eitskin/touches", touches, qos_profile_sensor_data)
node.create_subscription(Image, "/eitskin/map", image, qos_profile_sensor_data)
rclpy.spin(node)
"""


@pytest.fixture(scope="module")
def ros(tmp_path_factory):
    """The interpreter of an environment with the runtime and rclpy; skipped where the index has none for it."""
    folder = tmp_path_factory.mktemp("ros")
    subprocess.run([sys.executable, "-m", "venv", folder / "v"], check=True, timeout=PATIENCE_S)
    python = folder / "v" / "bin" / "python"
    done = subprocess.run(
        [python, "-m", "pip", "--disable-pip-version-check", "--quiet", "install", "--constraint", "constraints.txt",
         ".", *PACKAGES], cwd=ROOT, capture_output=True, text=True, check=False, timeout=PATIENCE_S,
    )  # fmt: skip
    if re.search(r"No matching distribution|Connection|Temporary failure|Max retries", done.stderr):
        pytest.skip(f"no package index: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    return python


def test_a_node_publishes_touches_in_metres_and_maps_on_standard_messages(ros, runtime, tmp_path):
    (tmp_path / "listener.py").write_text(LISTENER)
    environment = {
        "ROS_DOMAIN_ID": str(os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(tmp_path), "PYTHONPATH": "",
    }  # fmt: skip
    away = np.array([2000.0, 0.0, 250.0])[:, None, None]
    eitskin.send_cloud(runtime.control, flat_cloud() + away)  # whatever others of these tests have sent
    listener = Process("listener.py", folder=tmp_path, python=ros, **environment)
    words = ("--ros-args", "-p", f"endpoint:={runtime.frames}", "-p", "frame_id:=forearm")
    node = Process(ROOT / "docs/examples/ros2_node.py", *words, folder=tmp_path, python=ros, **environment)
    try:
        assert listener.until("nothing touches")
        _, frame_id, x, y, z, facing, number = listener.until("touch forearm").split()
        assert frame_id == "forearm"
        assert 2000.0 < float(x) < 2150.0
        assert 0.0 < float(y) < 100.0
        assert (float(z), float(facing)) == (250.0, 1.0)
        assert int(number) > 0
        _, encoding, rows, columns, row, column = listener.until("map ").split()
        assert (encoding, rows, columns) == ("32FC1", "30", "45")
        assert int(row) < 30
        assert int(column) < 45
    finally:
        for process in (node, listener):
            process.end()


def test_a_node_without_a_runtime_says_that_it_is_blind(ros, tmp_path):
    words = ("--ros-args", "-p", f"endpoint:=ipc://{tmp_path}/nobody")
    environment = {"ROS_DOMAIN_ID": str(os.getpid() % 100), "ROS_LOG_DIR": str(tmp_path), "PYTHONPATH": ""}
    node = Process(ROOT / "docs/examples/ros2_node.py", *words, folder=tmp_path, python=ros, **environment)
    try:
        assert "nobody" in node.until("blind: no frame from")
    finally:
        node.end()
