"""``eitskin build`` of the tiny recipe, killed at several points and started again, to a bundle with a card."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from eitskin.model.bundle import load_bundle
from eitskin_proto.skin.toml import named

pytestmark = [pytest.mark.slow, pytest.mark.process]

COMMAND = [sys.executable, "-m", "eitskin_tools.cli", "build", "tiny", "--threads=1", "--workers=1", "--json"]
PATIENCE_S = 900.0
"""How long a busy machine may take to the next point; a quiet one takes seconds."""


def killed_once_there_is(point, out):
    """Start a build and kill it without a word when a file appears."""
    process = subprocess.Popen(
        [*COMMAND, f"--out={out}"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True, text=True
    )
    end = time.monotonic() + PATIENCE_S
    while not point.exists():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < end
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert not out.exists()


def test_a_build_that_is_killed_anywhere_goes_on(tmp_path):
    out, folder = tmp_path / "t.eitskin", tmp_path / "t.eitskin.build"
    kept = {}
    for name in ("data/presses/deformation-0002.npz", "runs/1/best.pt", "card/contrast-0.4.json"):
        killed_once_there_is(folder / name, out)
        for earlier, stamp in kept.items():
            assert (folder / earlier).stat().st_mtime_ns == stamp, f"{earlier} was made again"
        if name != "runs/1/best.pt":  # a second epoch may be a better one
            kept[name] = (folder / name).stat().st_mtime_ns
    done = subprocess.run([*COMMAND, f"--out={out}"], capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    bundle = load_bundle(out)
    assert said["bundle"] == bundle.id
    assert (bundle.touch_kind, bundle.labels, bundle.skin) == ("lower", "area", named("hydrogel"))
    assert bundle.manifest["build"]["name"] == "tiny"
    assert len(bundle.manifest["recipe"]["noises"]) == 3
    card = bundle.manifest["metrics"]["card"]
    assert [one["contrast"] for one in card["by_contrast"]] == [0.2, 0.4, 0.6, 0.8]
    assert all([row["name"] for row in one["rows"]] == ["none", "random"] for one in card["by_contrast"])
    assert [row["name"] for row in card["by_mismatch"]][:3] == ["none", "random", "lab mix"]
    assert all(-1.0 <= row["press04"]["cc"] <= 1.0 for row in card["by_mismatch"])
