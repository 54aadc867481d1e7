"""LeRobot's camera and data sets of a skin: against its interface alone, and in an environment with LeRobot itself."""

import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.tools.view.scripted import Runtime, Scene, disc

import eitskin
from eitskin.model.bundle import load_bundle
from eitskin_tools import cli
from eitskin_tools.recording.convert import table_of
from eitskin_tools.recording.frames import RecordedFrames
from eitskin_tools.recording.resample import regular_ns, resampled
from eitskin_tools.recording.script import Script

from .conftest import TINY, measured, recorded

ROOT = Path(__file__).parents[3]
PLUG_IN = ROOT / "tools/lerobot/lerobot_camera_eitskin"
LEAST_FREE_GB = 6


@pytest.fixture
def plug_in(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The plug-in on what it uses of LeRobot."""

    @dataclass(kw_only=True)
    class CameraConfig:
        fps: int | None = None
        width: int | None = None
        height: int | None = None
        register_subclass = staticmethod(lambda name: lambda kind: kind)

    class Camera:
        def __init__(self, config: Any) -> None:
            self.fps, self.width, self.height = config.fps, config.width, config.height

    class DeviceNotConnectedError(ConnectionError):
        pass

    errors = {"DeviceNotConnectedError": DeviceNotConnectedError, "DeviceAlreadyConnectedError": ConnectionError}
    for name, content in {
        "lerobot": {}, "lerobot.cameras": {}, "lerobot.utils": {}, "lerobot.cameras.camera": {"Camera": Camera},
        "lerobot.cameras.configs": {"CameraConfig": CameraConfig}, "lerobot.utils.errors": errors,
    }.items():  # fmt: skip
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(PLUG_IN))
    import lerobot_camera_eitskin

    yield lerobot_camera_eitskin
    for name in [name for name in sys.modules if name.startswith("lerobot_camera_eitskin")]:
        del sys.modules[name]


def touch(number: int, area_mm2: float) -> Any:
    return SimpleNamespace(
        id=number, place_mm=(1, 2, 3), normal=(0, 0, 1), area_mm2=area_mm2, peak=0.9, age_s=0.1 * number
    )


def test_touches_are_the_four_largest_in_order_and_then_zeros(plug_in: Any) -> None:
    feature = plug_in.touch_features()["observation.tactile.touches"]
    assert (feature["dtype"], feature["shape"], len(feature["names"])) == ("float32", (4, 9), 9)
    found = plug_in.touch_array([touch(9, 80.0), touch(2, 90.0)])
    np.testing.assert_allclose(
        found[:2], [[1, 2, 3, 0, 0, 1, 90, 0.9, 0.2], [1, 2, 3, 0, 0, 1, 80, 0.9, 0.9]], rtol=1e-6
    )
    assert (found.dtype, found.shape, found[2:].any()) == (np.float32, (4, 9), False)
    assert plug_in.touch_array([touch(n, 10.0 * n) for n in range(1, 7)])[:, 6].tolist() == [30, 40, 50, 60]


def test_a_camera_reads_the_newest_map_and_touches_and_never_an_old_one(plug_in: Any, tmp_path: Path) -> None:
    endpoint, scene = f"ipc://{tmp_path}/frames", Scene(map=disc(60.0, 40.0))
    camera = plug_in.EitskinCamera(plug_in.EitskinCameraConfig(endpoint=endpoint, max_age_s=60.0))
    with pytest.raises(ConnectionError):
        camera.read()
    with Runtime(endpoint, scene):
        camera.connect()
        before, image = camera.frame.number, camera.async_read(timeout_ms=5000)
        assert camera.frame.number > before
        assert (image.shape, image.dtype) == ((240, 360, 3), np.uint8)
        np.testing.assert_array_equal(image[::8, ::8, 1], np.rint(255 * scene.map))
        assert camera.touches.tolist() == plug_in.touch_array(camera.frame.touches).tolist()
        assert camera.touches[0, 7] == scene.map.max()
        with pytest.raises(eitskin.StaleFrame, match="s old, expected at most 1e-06 s"):
            plug_in.EitskinCamera(plug_in.EitskinCameraConfig(endpoint=endpoint, max_age_s=1e-6)).connect()
        with pytest.raises(ValueError, match="height 240 and width 360, expected 240 and 640: set both"):
            plug_in.EitskinCamera(plug_in.EitskinCameraConfig(endpoint=endpoint, width=640)).connect()
    with pytest.raises(eitskin.NoFrame, match="no frame from"):  # behind those on their way
        _ = [camera.async_read() for _ in range(1000)]
    with pytest.raises(eitskin.StaleFrame):
        camera.read_latest(max_age_ms=0)
    camera.config.max_age_s = 0.0
    with pytest.raises(eitskin.StaleFrame):
        _ = camera.touches
    camera.disconnect()
    assert not camera.is_connected


def test_without_lerobot_a_data_set_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recorded(tmp_path / "a.mcap", measured(60))
    words = ["--out", str(tmp_path / "a"), "--lerobot", "--rate", "30"]
    assert cli.main(["convert", str(tmp_path / "a.mcap"), *words]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "needs LeRobot and the plug-in of tools/lerobot" in err


def test_an_episode_of_one_frame_is_refused_before_anything_is_written(
    plug_in: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, f"{plug_in.__name__}.dataset", SimpleNamespace(write_dataset=None))
    recorded(tmp_path / "a.mcap", measured(60))
    words = ["--out", str(tmp_path / "a"), "--lerobot", "--rate", "1", "--bundle", str(TINY)]
    assert cli.main(["convert", str(tmp_path / "a.mcap"), *words]) == 1
    assert ": 1 of 1 times have a published frame, but an episode has at least 2" in capsys.readouterr().err


PROGRAM = """
import os, sys, torch
os.environ["HF_HUB_OFFLINE"] = "1"
operators = torch.library.Library("torchvision", "DEF")  # its own are for CUDA, which torch has not here
for name in ("nms", "qnms"):
    operators.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")

import numpy as np
from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.import_utils import register_third_party_plugins

from eitskin_tools import cli

endpoint, out, *words = sys.argv[1:]
assert cli.main([*words, "--out", out]) == 0
found = LeRobotDataset("skin", root=out)
rows = [found[k] for k in range(len(found))]
np.savez(
    out + ".npz",
    fps=found.fps, episode=[int(row["episode_index"]) for row in rows],
    image=[255 * row["observation.images.skin"].numpy() for row in rows],
    touches=[row["observation.tactile.touches"].numpy() for row in rows],
)
register_third_party_plugins()
config = CameraConfig.get_choice_class("eitskin")(endpoint=endpoint)
with make_cameras_from_configs({"skin": config})["skin"] as camera:
    print("read", camera.async_read(5000).shape, int((camera.touches != 0).any(axis=1).sum()))
"""


@pytest.fixture(scope="module")
def lerobot_python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter with LeRobot 0.4.4 and what its data sets need; skipped where that cannot be had."""
    folder = tmp_path_factory.mktemp("lerobot")
    if (free_gb := shutil.disk_usage(folder).free / 1e9) < LEAST_FREE_GB:
        pytest.skip(f"{free_gb:.0f} GB free, LeRobot needs {LEAST_FREE_GB}")
    python = folder / "v/bin/python"
    subprocess.run([sys.executable, "-m", "venv", folder / "v"], check=True)
    for words in (
        ["torch==2.13.0"],  # alone and first, as constraints.txt says
        ["--no-deps", "lerobot==0.4.4", "torchvision==0.29.1"],
        ["datasets>=4,<5", "huggingface-hub<0.36", "av<16", "draccus==0.10.0", "jsonlines", "packaging<26", "deepdiff",
         "termcolor", "imageio", "einops", "accelerate", "opencv-python-headless", "torch==2.13.0", "--editable",
         f"{ROOT}[record]"],
        ["--no-deps", str(PLUG_IN)],
    ):  # fmt: skip
        pip = [python, "-m", "pip", "--disable-pip-version-check", "--quiet", "install", *words]
        done = subprocess.run(pip, capture_output=True, text=True, check=False)
        if re.search(r"No matching distribution|Connection|Temporary failure|Max retries|No space left", done.stderr):
            pytest.skip(f"no LeRobot: {done.stderr.strip().splitlines()[-1]}")
        assert done.returncode == 0, done.stderr
    return python


@pytest.mark.slow
@pytest.mark.process
def test_two_recordings_are_two_episodes_that_lerobot_reads_back_equal(
    lerobot_python: Path, plug_in: Any, tmp_path: Path
) -> None:
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path, frames in zip(paths, (150, 90), strict=True):
        recorded(path, measured(frames))
    (tmp_path / "program.py").write_text(PROGRAM)
    words = ["convert", *map(str, paths), "--lerobot", "--rate", "30", "--bundle", str(TINY), "--task", "touch"]
    endpoint = f"ipc://{tmp_path}/frames"
    with Runtime(endpoint, Scene(map=disc(60.0, 40.0))):
        done = subprocess.run(
            [lerobot_python, tmp_path / "program.py", endpoint, tmp_path / "set", *words],
            capture_output=True, text=True, check=False, cwd=tmp_path,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "read (240, 360, 3) 1" in done.stdout
    maps, touches, episode = list[Any](), list[Any](), list[int]()
    for number, path in enumerate(paths):
        script = Script(path)
        table = table_of(script, frames=RecordedFrames(script, load_bundle(TINY)), compute_maps=True)
        table = resampled(table, regular_ns(table, 30))
        maps += list(table.maps)
        touches += map(plug_in.touch_array, table.touches_by_row())
        episode += [number] * len(table.maps)
    images = np.array([plug_in.image_of(values) for values in maps])
    with np.load(tmp_path / "set.npz") as found:
        assert int(found["fps"]) == 30
        assert found["episode"].tolist() == episode
        assert np.rint(found["image"]).astype(np.uint8).transpose(0, 2, 3, 1).tobytes() == images.tobytes()
        assert found["touches"].tobytes() == np.array(touches).tobytes()
    assert any(rows.any() for rows in touches)
