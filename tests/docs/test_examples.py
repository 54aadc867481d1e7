"""Every program of docs/examples runs as it stands, against a virtual skin and a runtime of their own."""

import socket
import threading
import time
from contextlib import contextmanager, suppress
from urllib.request import Request, urlopen

import numpy as np
import pytest
from tests.tools.view.unpacking import unpacked

from eitskin.messaging.publish import Publisher
from eitskin.messaging.streams.verified import VerifiedTouch, pack_head, pack_verdict
from eitskin_proto.skin.cloud import align_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.bend import surface
from eitskin_sim.scene.parts import Scene
from eitskin_sim.scene.scene import load_scene
from eitskin_tools.view.messages import packed

from .markdown import ROOT

EXAMPLES = ROOT / "docs/examples"

pytestmark = [pytest.mark.slow, pytest.mark.process]


def test_subscribe_prints_frame_after_frame(example, runtime):
    with example("subscribe.py", runtime.frames) as program:
        first, second = (int(program.until("ms old").split()[1].rstrip(":")) for _ in range(2))
    assert second > first


def test_touches_come_without_maps(example, runtime):
    with example("touches.py", runtime.frames) as program:
        assert "born" in program.until(": touch ")
        assert "facing " in program.until("touch 1 at")


def test_frames_are_read_without_eitskin_installed(example, runtime, tmp_path):
    (tmp_path / "eitskin.py").write_text("raise ModuleNotFoundError('eitskin is not installed here')\n")
    with example("without_eitskin.py", runtime.frames, PYTHONPATH=str(tmp_path)) as program:
        assert "at row, column" in program.until("highest pixel")


def test_touches_cross_zenoh(example, runtime):
    pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
    with example("zenoh_bridge.py", "out", runtime.frames), example("zenoh_bridge.py", "in") as program:
        program.until(": 1 touches")
        program.until("since publishing: p50")


def test_a_robot_goes_stops_where_it_is_touched_and_stops_when_it_is_blind(example, runtime):
    with example("react.py", runtime.frames) as robot:
        robot.until("go")
        robot.until("stop")
        assert "mm, y" in robot.until("touched at")


def test_a_robot_acts_on_verified_touches_alone(example, tmp_path):
    touch = VerifiedTouch(
        shape="unit", unit=63, centre_mm=(80.0, 50.0), centre_error_mm=None, size_mm=(10.0, 11.0), size_error_mm=None,
        angle_rad=0.0, area_mm2=110.0, area_error_mm2=None, contrast=50.0, strength_mm2=430.0, strength_error_mm2=None,
        border_mm=0.0, place_mm=(80.0, 50.0, 7.5), normal=(0.0, 0.0, 1.0),
    )  # fmt: skip
    said = [
        ("preparing", None, (), "wait: preparing"),
        ("ready", (900.0, 104, 1e-9, True), (touch,), "wait: frame 2 is flagged: unexplained, p 1e-09"),
        ("ready", None, (), "wait: ready it is late"),
        ("ready", (101.0, 104, 0.5, False), (touch,), "act at 80.0 50.0 7.5 mm, strength 430 mm2"),
        ("waiting", None, (), "wait: waiting it ended"),
        ("ready", (101.0, 104, 0.5, False), (touch,), "wait: frame 6: places in space are unknown"),
    ]
    whys = {2: "unexplained", 3: "it is late", 5: "it ended", 6: "fitted"}
    publisher = Publisher(f"ipc://{tmp_path}/frames")
    try:
        with example("verified.py", publisher.endpoint) as robot:
            while not publisher.verified:
                publisher.update()
                time.sleep(0.01)
            for number, (state, verdict, touches, expected) in enumerate(said, 1):
                why = whys.get(number, "")
                counts = {"checked": 0, "flagged": 0, "skipped": 0}
                told = pack_verdict(number, 0, 0, state, why, (1, 2, 3, 4), verdict, touches)
                publisher.send_beside(pack_head(number, "run", counts) + told)
                robot.until(expected)
    finally:
        publisher.close()


def test_a_cloud_goes_to_the_runtime_with_its_prediction(example, start, runtime, tmp_path):
    cloud = tmp_path / "cloud.npz"
    with start("-m", "eitskin_tools.cli", "surface", EXAMPLES / "surface.ply", "--out", cloud) as program:
        program.until("corner (0, 0)")
        program.until("6000 points")
    with example("send_cloud.py", cloud, runtime.control) as program:
        assert "is in use" in program.until("cloud ")
    scene = load_scene(EXAMPLES / "scene.json")
    places = surface(scene.bend, scene.sheet, PAPER.grid.pixel_centres_mm().reshape(-1, 2))
    with np.load(cloud) as file:
        assert (
            abs(file["cloud"] - align_cloud(places.T.reshape(3, 30, 45))).max() < 2.0
        )  # mm, at the border; the points have 0.1 mm of noise


@pytest.fixture(scope="module")
def robot(start, skin, tmp_path_factory):
    """The example's robot.toml with two virtual skins, each with its reference, and a runtime of both."""
    folder = tmp_path_factory.mktemp("robot")
    text = (EXAMPLES / "robot.toml").read_text(encoding="utf-8")
    with skin() as first, skin() as second:
        for port, number, name in ((first, 1, "forearm"), (second, 2, "hand")):
            text = text.replace(f"/dev/serial/by-id/usb-eitskin_SKIN-000{number}-if00", port)
            words = ["--port", port, "--frames", "20", "--out", folder / f"{name}.json"]
            with start("-m", "eitskin_tools.cli", "reference", *words) as program:
                program.until("20 frames")
        stated = text.replace("version = 1", f'version = 1\nfolder = "{folder}/sockets"')
        (folder / "robot.toml").write_text(stated, encoding="utf-8")
        with start("-m", "eitskin_tools.cli", "run", "--config", folder / "robot.toml") as program:
            assert "forearm, hand" in program.until("ready 2 of 2 skins publish")
            yield folder / "robot.toml"


def test_all_skins_are_felt_in_one_loop(example, robot):
    with example("all_skins.py", robot) as felt:
        assert "axes x [1.0, 0.0, 0.0]" in felt.until("forearm sits at 120 0 340 mm")
        felt.until("hand: touch ")
        felt.until("forearm: touch ")


def test_all_skins_are_in_the_viewers_one_stream(start, robot):
    with start("-m", "eitskin_tools.cli", "view", "--config", robot, "--port", "0", "--no-open") as page:
        address = page.until("viewing forearm, hand of ").split()[-3]
        page_address, _, token = address.partition("#token=")
        asked = Request(f"{page_address}stream", headers={"Authorization": f"Bearer {token}"})
        with urlopen(asked, timeout=120) as stream:
            waiting, seen = b"", set()
            while seen < {("skin", "forearm"), ("skin", "hand"), ("frame", 0), ("frame", 1)}:
                waiting += stream.read1(65536)
                whole = unpacked(waiting)
                waiting = waiting[sum(len(packed(*message)) for message in whole) :]
                seen |= {(head["kind"], head.get("name", head["of"])) for head, _ in whole}


def test_a_skin_is_read_within_one_process(example, skin):
    with skin() as port, example("in_process.py", port) as program:
        assert "weak rows 0" in program.until("reference of 50 frames")
        program.until("touched at")
        assert "lost" in program.until(" frames, ")


def test_a_driver_of_ones_own_reads_lines_over_tcp(example):
    with printing() as number, example("own_driver.py", f"127.0.0.1:{number}") as program:
        assert "highest pixel 0.00" in program.until("over TCP")


@contextmanager
def printing():
    """A device that sends the flat sheet's 208 voltages, with noise of 50 dB, to whom connects; gives its TCP port."""
    flat_V = 1e-3 * solve_scene(Scene(element_size_mm=4.0)).voltages208
    listener = socket.create_server(("127.0.0.1", 0))
    over = threading.Event()

    def send():
        noise = np.random.default_rng(0)
        with suppress(OSError):
            peer, _ = listener.accept()
            with peer:
                while not over.wait(0.02):
                    volts = flat_V * (1.0 + 0.003 * noise.normal(size=208))
                    peer.sendall(" ".join(f"{one:.9f}" for one in volts).encode() + b"\n")

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        over.set()
        with suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join()


def test_presses_are_simulated_with_an_untouched_reading_before_each(example, tmp_path):
    with example("simulate_presses.py", EXAMPLES / "press.json", tmp_path / "presses.npz", 2) as program:
        program.ends()
    with np.load(tmp_path / "presses.npz") as found:
        assert np.isnan(found["xy_mm"][:, 0]).tolist() == [True, False, True, False]
        assert 0.01 < np.log(found["voltages_V"][1] / found["voltages_V"][0]).std() < 0.3


def test_a_finger_in_mujoco_is_felt(example, tmp_path):
    pytest.importorskip("mujoco", reason="a simulated finger needs the extra 'simulators'")
    with example("mujoco_finger.py", 3, tmp_path / "finger.png") as program:
        assert program.ends().startswith("felt 3 of 3 presses, 0.")
    assert (tmp_path / "finger.png").read_bytes().startswith(b"\x89PNG")
