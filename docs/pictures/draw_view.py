"""Draw the pictures of the page of ``eitskin view`` in a headless Chromium, of virtual skins as they are streamed.

- view.png: one skin, in front of the demonstration
- view_skins.png: two skins of a robot, in one scene
- view_file.png: a recording, at a moment in the middle of it
- view.gif: eight seconds of one skin, for the README

Needs the extra ``dev`` and Chromium (``tools/system-packages.sh chromium``). ``python docs/pictures/draw_view.py``
draws all of them, or those that are named behind it.
"""

import io
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "tools" / "view"))
from chromium import Browser  # noqa: E402

PATIENCE_S = 300.0

MOVING_MS, STEP_MS = 8000, 160
"""What the moving picture shows, and how far apart its frames are."""

GOOD = """(() => {
    const shown = window.eitskin && eitskin.history && eitskin.history.shown;
    if (!shown || eitskin.history.newest.t - eitskin.history.oldest.t < 40000) return false;
    const { radius, corners } = shown.surface;
    const z = corners.filter((_, k) => k % 3 === 2), high = Math.max(...z) - Math.min(...z);
    return shown.head.touches.length >= 2 && high > 20 && shown.head.cloud === shown.surface.revision && radius > 0;
})()"""
"""A moment worth showing: two touches on a bent sheet, and some history."""

BOTH = """(() => {
    const skins = window.eitskin ? eitskin.page.skins : [], [arm, hand] = skins.map((one) => one?.history);
    if (skins.length < 2 || !hand?.known || !arm?.known || arm.newest.t - arm.oldest.t < 45000) return false;
    return arm.shown.head.touches.length === 2 && hand.shown.head.touches.length >= 1;
})()"""
"""The same, of two skins."""

ROBOT = """
format = "eitskin-robot"
version = 1
folder = "{folder}/s"
[[skins]]
name = "forearm"
port = "{ports[0]}"
[skins.pose]
translation_mm = [0, 40, 0]
rotation = [[1, 0, 0], [0, 0.5, -0.866], [0, 0.866, 0.5]]
[[skins]]
name = "hand"
port = "{ports[1]}"
[skins.pose]
translation_mm = [265, -20, 20]
rotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
"""


@contextmanager
def started(*words: object, until: str) -> Iterator[str]:
    """Run a command of eitskin; give the line that holds a text."""
    process = subprocess.Popen(
        [sys.executable, "-m", "eitskin_tools.cli", *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    try:
        yield next(line for line in process.stdout if until in line)
    finally:
        process.terminate()
        process.communicate()


def address_in(line: str) -> str:
    """Return the page's address."""
    found = re.search(r"(http://\S+)", line)
    assert found, line
    return found[1]


def wait(page: Any, wanted: str) -> None:
    """Wait for a moment worth showing."""
    end = time.monotonic() + PATIENCE_S
    while not page.evaluate(wanted):
        assert time.monotonic() < end, "no moment worth showing"


def draw(page: Any, name: str) -> None:
    """Write what is to be seen, once it has come to rest."""
    page.evaluate("document.activeElement.blur()")
    for _ in range(40):  # the camera comes to rest
        drawn = page.evaluate("eitskin.page.changed = true, eitskin.page.slowAt = 0, eitskin.page.drawings")
        page.wait(f"eitskin.page.drawings > {drawn}")
    picture = Image.open(io.BytesIO(page.picture())).convert("RGB")
    picture.save(Path(__file__).with_name(name), optimize=True)


def one() -> None:
    """Draw one skin, still and moving."""
    with started("demo", "--view", "--rate", 100, until="http://") as line, Browser(1280, 720) as page:
        page.open(address_in(line))
        wait(page, GOOD)
        page.evaluate("document.getElementById('pause').click()")
        draw(page, "view.png")
        page.resize(1120, 630)
        end = page.evaluate("eitskin.history.newest.t")
        shots = []
        for back in range(MOVING_MS, 0, -STEP_MS):
            page.evaluate(f"eitskin.clock.go({end} - {back}), eitskin.page.changed = true")
            drawn = page.evaluate("eitskin.page.changed = true, eitskin.page.slowAt = 0, eitskin.page.drawings")
            page.wait(f"eitskin.page.drawings > {drawn} + 1")
            shots.append(
                Image.open(io.BytesIO(page.picture())).convert("RGB").resize((960, 540), Image.Resampling.LANCZOS)
            )
    # One palette for all frames: still pixels stay equal from frame to frame, so that only what moves is stored.
    palette = shots[len(shots) // 2].quantize(200, Image.Quantize.MAXCOVERAGE, kmeans=3)
    frames = [shot.quantize(palette=palette, dither=Image.Dither.NONE) for shot in shots]
    target = Path(__file__).with_name("view.gif")
    frames[0].save(target, save_all=True, append_images=frames[1:], duration=STEP_MS, loop=0, optimize=True)


def several_and_file() -> None:
    """Draw two skins of a robot, and a recording of one of them."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="draw-")))
        skins = [stack.enter_context(started("virtual-skin", "--rate", 100, until="ttySKIN")) for _ in range(2)]
        ports = [next(word for word in line.split() if "ttySKIN" in word) for line in skins]
        robot = folder / "robot.toml"
        robot.write_text(ROBOT.format(folder=folder, ports=ports), encoding="utf-8")
        stack.enter_context(started("run", "--config", robot, until="ready 2 of 2"))
        line = stack.enter_context(started("view", "--config", robot, "--port", 0, "--no-open", until="http://"))
        day = folder / "day.mcap"
        words = ["record", f"ipc://{folder}/s/forearm/frames", "--out", day, "--seconds", 60]
        recorder = subprocess.Popen([sys.executable, "-m", "eitskin_tools.cli", *map(str, words), "--quiet"])
        with Browser(1280, 720) as page:
            page.open(address_in(line))
            wait(page, BOTH)
            page.evaluate("document.getElementById('pause').click()")
            draw(page, "view_skins.png")
        assert recorder.wait() == 0
        with started("view", day, "--port", 0, "--no-open", until="http://") as line, Browser(1280, 720) as page:
            page.open(address_in(line))
            page.wait("window.eitskin && eitskin.history && eitskin.history.share === 1")
            page.evaluate("eitskin.clock.go(31000)")
            moment = "eitskin.history.ready(eitskin.clock.at) && eitskin.history.shown.head.touches.length >= 2"
            while not page.evaluate(f"eitskin.page.changed = true, {moment}"):
                page.evaluate("eitskin.history.ready(eitskin.clock.at) && eitskin.clock.go(eitskin.clock.at + 250)")
            draw(page, "view_file.png")


if __name__ == "__main__":
    wanted = set(sys.argv[1:]) or {"view.png", "view_file.png"}
    if wanted & {"view_skins.png", "view_file.png"}:
        several_and_file()
    if wanted & {"view.png", "view.gif"}:
        one()
