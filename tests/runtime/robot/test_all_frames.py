"""Frames of several skins in one iterator: by name, in turn, newest or all; a silent one is named, the others go on."""

import threading
from contextlib import contextmanager

import numpy as np
import pytest

import eitskin
from eitskin.errors import SilentSkin, StaleFrame
from eitskin.messaging.frame import EVERY_FRAME
from eitskin.messaging.frame_message import FramePacker
from eitskin.messaging.publish import Publisher
from eitskin.touches.surface import Surface
from eitskin.touches.watch import TouchWatch
from eitskin_proto.skin.skin import PAPER

from ..messaging.publishing import send, wait_for

GRID = PAPER.grid
PATIENCE_S = 60.0


class Published:
    """A skin that publishes when it is told to."""

    def __init__(self, folder, name):
        (folder / name).mkdir()
        self.publisher = Publisher(f"ipc://{folder}/{name}/frames")
        self.packer = FramePacker(configuration="p/1", bundle="b", serial_number=name, run="r", shape=GRID.shape)
        self.packer.put_texts("vd2t", (), ())
        self.number = 0

    def send(self, count=1, age_us=100):
        for _ in range(count):
            self.number += 1
            send(self.publisher, self.packer, self.number, age_us)


@pytest.fixture
def robot(tmp_path):
    """Two skins that publish, and the path of their robot.toml."""
    text = f'format = "eitskin-robot"\nversion = 1\nfolder = "{tmp_path}"\n'
    text += '[[skins]]\nname = "left"\nport = "/dev/l"\npose.translation_mm = [100, 0, 0]\n'
    text += '[[skins]]\nname = "right"\nport = "/dev/r"\npose.rotation = [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]\n'
    (tmp_path / "robot.toml").write_text(text)
    skins = {name: Published(tmp_path, name) for name in ("left", "right")}
    yield tmp_path / "robot.toml", skins
    for one in skins.values():
        one.publisher.close()


def wait_until_wanted(skins, topic=EVERY_FRAME):
    for one in skins.values():
        wait_for(one.publisher, lambda: topic in one.publisher.topics)  # noqa: B023 -- it waits at once


@contextmanager
def sending(skin, **how):
    """Send one frame after the other, as a stream does: a new subscriber misses some."""
    done = threading.Event()

    def send():
        while not done.wait(0.01):
            skin.send(**how)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def test_all_frames_of_all_skins_come_by_name_and_in_order(robot):
    path, skins = robot
    with eitskin.subscribe_all(path, "all", timeout_s=PATIENCE_S) as frames:
        wait_until_wanted(skins)
        skins["left"].send(30)
        skins["right"].send(10)
        found = [next(frames) for _ in range(40)]
        assert frames.received == {"left": 30, "right": 10}
        assert frames.lost == {"left": 0, "right": 0}
    for name, count in (("left", 30), ("right", 10)):
        own = [one.frame for one in found if one.skin == name]
        assert [frame.number for frame in own] == list(range(1, count + 1))
        assert {frame.serial_number for frame in own} == {name}


def test_the_newest_of_each_comes_however_slow_the_loop_is(robot):
    path, skins = robot
    with eitskin.subscribe_all(path, timeout_s=PATIENCE_S) as frames:
        wait_until_wanted(skins)
        for one in skins.values():
            one.send(50)
        newest = {}
        while set(newest.values()) != {50} or len(newest) < 2:
            one = next(frames)
            newest[one.skin] = one.frame.number
        assert sum(frames.received.values()) < 100


def test_touches_come_in_the_frame_of_the_robot(robot):
    path, skins = robot
    image = np.zeros(GRID.shape)
    image[9:12, 19:22] = 1.0
    packed = TouchWatch(GRID).update(image.ravel(), 1, Surface(GRID.flat_cloud_mm(), GRID), 1_000_000)
    x, y = 20.5 * 10 / 3, 10.5 * 10 / 3
    with eitskin.subscribe_all(path, "all", timeout_s=PATIENCE_S, touches=True) as frames:
        wait_until_wanted(skins, b"\xde")
        for one in skins.values():
            one.packer.put_touches(packed)
            one.send()
        found = {one.skin: one for one in (next(frames), next(frames))}
    (left,), (right,) = found["left"].touches, found["right"].touches
    assert left.place_mm == pytest.approx((x + 100.0, y, 0.0), abs=1e-4)
    assert right.place_mm == pytest.approx((-x, -y, 0.0), abs=1e-4)
    assert left.normal == pytest.approx((0.0, 0.0, 1.0))
    assert found["left"].frame.touches[0].place_mm == pytest.approx((x, y, 0.0), abs=1e-4)  # the skin's own


def test_a_silent_skin_is_named_and_the_other_goes_on(robot):
    path, skins = robot
    with eitskin.subscribe_all(path, "all", timeout_s=0.5) as frames:
        wait_until_wanted(skins)
        skins["right"].send()
        got, silent = set(), {}
        while "left" not in silent or "right" not in got:
            try:
                got.add(next(frames).skin)
            except SilentSkin as error:
                silent[error.skin] = str(error)
                skins["right"].send()
        assert "left" not in got
        assert "no frame of skin left from ipc://" in silent["left"]
        assert "within 0.5 s" in silent["left"]
        assert frames.silent_s()["left"] > 0.4


def test_a_stale_frame_is_an_error_with_the_name(robot):
    path, skins = robot
    with eitskin.subscribe_all(path, timeout_s=PATIENCE_S, max_age_s=1.0) as frames:
        wait_until_wanted(skins)
        with sending(skins["left"], age_us=2_000_000), pytest.raises(StaleFrame, match="of skin left is 2"):
            next(frames)


@pytest.mark.parametrize("options", [{"timeout_s": 0}, {"max_age_s": -1}, {"mode": "some"}])
def test_bad_arguments_are_refused(robot, options):
    with pytest.raises(ValueError, match="expected"):
        eitskin.subscribe_all(robot[0], **options)
