"""The stream of ``tools/ros2``, which needs neither ROS nor eitskin, reads what the runtime packs."""

import ast
import importlib.util
import random
import re
import struct
import xml.etree.ElementTree as ET
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from eitskin.messaging.frame import host_id, unpack_frame
from eitskin.messaging.frame_message import FramePacker
from eitskin_proto.skin.skin import PAPER

PACKAGE = Path(__file__).parents[2] / "tools/ros2/eitskin_ros"


@pytest.fixture(scope="module")
def stream():
    spec = importlib.util.spec_from_file_location("ros2_stream", PACKAGE / "eitskin_ros/stream.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def messages():
    """A frame with its map, one with its touches alone, and one of a runtime that sent shorter touches."""
    packer = FramePacker(configuration="paper/1", bundle="b", serial_number="s", run="r", shape=PAPER.grid.shape)
    packer.put_texts("vd2t", (), ("cloud",))
    packer.put("n", 7)
    packer.put("age_us", 2000)
    packer.put_map(memoryview(np.random.default_rng(1).random(1350, dtype=np.float32)).cast("B"))
    touches = b"".join(struct.pack("<II24f", number, 0, *range(number, number + 24)) for number in (3, 5))
    packer.put_touches((touches, b"", 0))
    alone = packer.touch_message()
    old = alone.replace(b"\xabtouch_bytes\x68", b"\xabtouch_bytes\x4c")
    old = old.replace(struct.pack(">BBB", 0xC4, len(touches), 3), struct.pack(">BBB", 0xC4, 76, 3))
    at = old.index(b"\xa7touches\xc4") + 10
    return bytes(packer.message()), alone, old[: at + 76] + old[at + len(touches) :]


def test_frames_are_those_that_a_python_subscriber_gets(stream, messages):
    for message in messages:
        ours, theirs = unpack_frame(message, 0), stream.decode_frame(message, host_id(), 0)
        fields = theirs.fields
        assert (fields["n"], fields["seq"], fields["touched"]) == (ours.number, ours.sequence, ours.touched)
        assert (fields["events"], theirs.same_host) == (list(ours.events), ours.same_host)
        assert bytes(theirs.map) == ours.map.tobytes()
        assert theirs.age_s == pytest.approx(ours.age_s, rel=1e-3)
        for touch, wanted in zip(theirs.touches, ours.touches, strict=True):
            assert (touch["id"], touch["area"], touch["peak"]) == (wanted.id, wanted.area_mm2, wanted.peak)
            assert tuple(touch[name] for name in ("x", "y", "z", "nx", "ny", "nz")) == wanted.place_mm + wanted.normal
            assert np.isnan(touch["amplitude"]) == (wanted.amplitude is None)
            assert np.isnan(touch["sign"]) == (wanted.sign is None)
            assert np.isnan(touch["velocity_x"]) == (wanted.velocity_mm_s is None)


def test_another_version_and_damaged_messages_are_refused(stream, messages):
    with pytest.raises(stream.StreamError, match="version 9; this package reads 2: update it"):
        stream.decode_frame(messages[1].replace(b"\xa1v\x02", b"\xa1v\x09"))
    for size in range(len(messages[1])):
        with pytest.raises(stream.StreamError):
            stream.decode_frame(messages[1][:size])
    rng = random.Random(1)
    for _ in range(2000):
        message = bytearray(messages[1])
        message[rng.randrange(len(message))] ^= 1 << rng.randrange(8)
        with suppress(stream.StreamError):
            assert len(stream.decode_frame(bytes(message)).touches) <= 16


def test_the_package_is_python_3_10_and_its_files_agree():
    for path in PACKAGE.rglob("*.py"):
        ast.parse(path.read_text(), feature_version=(3, 10))
    nodes = ET.parse(PACKAGE / "launch/skin.launch.xml").getroot().findall("node")
    assert "skin = {NAME}.node:main" in (PACKAGE / "setup.py").read_text()
    assert (nodes[0].get("pkg"), nodes[0].get("exec")) == ("eitskin_ros", "skin")
    source = (PACKAGE / "eitskin_ros/node.py").read_text()
    (declared,) = re.findall(r"^PARAMETERS = (\{.*?^\})", source, re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^    (\w+): (.+)$", (PACKAGE / "config/skin.yaml").read_text(), re.MULTILINE)
    assert {name: value.strip('"') for name, value in lines} == {
        name: str(value).lower() for name, value in ast.literal_eval(declared).items()
    }
    topics = set(re.findall(r"/eitskin/\w+", (PACKAGE / "config/skin.rviz").read_text()))
    assert (
        topics == {"/eitskin/touches", "/eitskin/map", "/eitskin/surface"} <= set(re.findall(r"/eitskin/\w+", source))
    )
