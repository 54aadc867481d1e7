"""Pages in a headless Chromium, and what they are of."""

import contextlib
import io
import signal
import subprocess
import sys
from urllib.parse import urlsplit

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_tools.view.source import Source
from eitskin_tools.view.viewer import Viewer

from .chromium import Browser


@pytest.fixture
def endpoint(tmp_path):
    """Where frames come from."""
    return f"ipc://{tmp_path}/frames"


@pytest.fixture
def viewer(endpoint):
    """A viewer of the paper's sheet."""
    with Viewer([Source(PAPER, endpoint)]) as found:
        yield found


BROWSERS_OWN = ("ERR_", "CONTEXT_LOST_WEBGL")
"""What a browser says of the network and of graphics that a busy machine took from it; the page goes on after both."""


@contextlib.contextmanager
def browser(address, *arguments, **more):
    """Give a browser with the page open; whatever it did, it said no error and asked nobody else."""
    with Browser(*arguments, **more) as found:
        found.open(address)
        yield found
        assert found.thrown == []
        assert [text for text in found.said if not any(own in text for own in BROWSERS_OWN)] == []
        assert {urlsplit(url).netloc for url in found.asked} == {urlsplit(address).netloc}


def picture(found):
    """Return (height, width, 3) of the screen."""
    pillow = pytest.importorskip("PIL.Image")
    return np.asarray(pillow.open(io.BytesIO(found.picture())).convert("RGB"), dtype=float)


def pixel(shot, place, half=2):
    """Return the mean colour about a place."""
    x, y = (round(value) for value in place)
    return shot[y - half : y + half + 1, x - half : x + half + 1].mean(axis=(0, 1))


def draws_newer(found):
    """Wait until a frame that comes from now on has been drawn."""
    found.evaluate("window.mark = eitskin.page.drawings, window.then = eitskin.history.newest.t")
    found.wait("eitskin.history.shown.t > window.then && eitskin.page.drawings > window.mark + 1")


def draws_again(found):
    """Wait until the page has been drawn from now on."""
    found.evaluate("window.mark = eitskin.page.drawings, eitskin.page.changed = true")
    found.wait("eitskin.page.drawings > window.mark")


def flat_place(found, x_mm, y_mm):
    """Return where a place of the sheet lies on the screen, in the flat map."""
    return found.evaluate(
        f"(() => {{ const b = document.getElementById('flat').getBoundingClientRect(), [x, y] = "
        f"eitskin.flat.place({x_mm}, {y_mm}); return [b.left + x, b.top + y]; }})()"
    )


def space_place(found, x_mm, y_mm, skin=0):
    """Return where a place of a sheet lies on the screen, on its bent surface."""
    return found.evaluate(
        f"(() => {{ const b = document.getElementById('scene').getBoundingClientRect(), [x, y] = "
        f"eitskin.page.project(eitskin.page.skins[{skin}].drawn.at({x_mm}, {y_mm}).place); "
        "return [b.left + x, b.top + y]; })()"
    )


def settled_place(found, x_mm, y_mm, skin=0):
    """Return :func:`space_place` once the camera has come to rest."""
    before, place = None, space_place(found, x_mm, y_mm, skin)
    while before is None or np.hypot(*np.subtract(place, before)) > 0.05:
        draws_again(found)
        before, place = place, space_place(found, x_mm, y_mm, skin)
    return place


@contextlib.contextmanager
def started(*words, until):
    """Run a command; give the line that says it is there."""
    process = subprocess.Popen(
        [sys.executable, "-m", "eitskin_tools.cli", *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, bufsize=1,
    )  # fmt: skip
    try:
        said = []
        for line in process.stdout:
            said.append(line)
            if until in line:
                break
        assert until in said[-1], said
        yield said[-1]
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
