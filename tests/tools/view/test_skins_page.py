"""Several skins in one scene: each where it sits, by its name; one that sends nothing is shown so, the rest goes on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eitskin.robot.pose import Pose
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.view.source import Source, sources_of
from eitskin_tools.view.viewer import Viewer

from .chromium import PROGRAM
from .conftest import browser, draws_newer, picture, pixel, settled_place, space_place
from .scripted import Runtime, Scene, disc

pytestmark = [
    pytest.mark.process,
    pytest.mark.slow,
    pytest.mark.skipif(PROGRAM is None, reason="no Chromium: tools/system-packages.sh chromium"),
]

ARM, HAND = Scene(disc(110.0, 30.0)), Scene(disc(40.0, 70.0))
BESIDE = Pose.of(rotation=[[0, -1, 0], [1, 0, 0], [0, 0, 1]], translation_mm=[300.0, 0.0, 40.0])
BOTH = (
    "window.eitskin && eitskin.page.drawings > 0 && eitskin.page.skins.length === 2 && "
    "eitskin.page.skins.every((one) => one?.history.newest)"
)


@pytest.fixture
def endpoints(tmp_path):
    return [f"ipc://{tmp_path}/arm", f"ipc://{tmp_path}/hand"]


@pytest.fixture
def viewer(endpoints):
    sources = [Source(PAPER, endpoints[0], "arm"), Source(PAPER, endpoints[1], "hand", BESIDE)]
    with Viewer(sources) as found:
        yield found


def test_each_touch_is_bright_where_its_skin_sits_on_the_robot(viewer, endpoints):
    with Runtime(endpoints[0], ARM), Runtime(endpoints[1], HAND), browser(viewer.address) as found:
        found.wait(f"{BOTH} && eitskin.page.skins.every((one) => one.history.shown.head.touches.length)")
        lit = [settled_place(found, 110.0, 26.0, 0), settled_place(found, 40.0, 66.0, 1)]
        dark = [space_place(found, 40.0, 70.0, 0), space_place(found, 110.0, 30.0, 1)]
        shot = picture(found)
        assert [pixel(shot, place, 1).min() > 110 for place in lit] == [True, True]
        assert [pixel(shot, place, 1).max() < 100 for place in dark] == [True, True]
        places = found.evaluate("eitskin.page.skins.map((one) => one.drawn.at(40, 70).place)")
        np.testing.assert_allclose(places, [[40, 70, 0], BESIDE.place([40, 70, 0])], atol=1e-3)
        touch = found.evaluate("eitskin.page.skins[1].history.shown.head.touches[0]")
        np.testing.assert_allclose(touch["place"], BESIDE.place([40, 70, 0]), atol=0.3)
        assert found.evaluate("document.documentElement.scrollHeight") <= 720


def test_all_skins_of_the_shipped_robot_are_within_the_picture_from_every_side(endpoints):
    shipped = sources_of(Path(__file__).parents[3] / "docs" / "examples" / "robot.toml", PAPER)
    sources = [replace(one, endpoint=endpoint) for one, endpoint in zip(shipped, endpoints, strict=True)]
    with (
        Viewer(sources) as viewer,
        Runtime(endpoints[0], ARM),
        Runtime(endpoints[1], HAND),
        browser(viewer.address) as found,
    ):
        found.wait(BOTH)
        left, top, width, height = found.evaluate(
            "(() => { const b = document.getElementById('scene').getBoundingClientRect(); "
            "return [b.left, b.top, b.width, b.height]; })()"
        )
        for key in ("1", "2", "3"):
            found.press(key)
            for skin in range(2):
                settled_place(found, 75.0, 50.0, skin)
                corners = np.array(
                    [space_place(found, x, y, skin) for x, y in ((0, 0), (150, 0), (150, 100), (0, 100))]
                )
                x, y = ((corners - [left, top]) / [width, height]).T
                assert 0.0 < min(x.min(), y.min()) < max(x.max(), y.max()) < 1.0
                area = abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2
                assert area > 0.01 or key == "2", "no skin is seen from its edge, but for an upright one from above"


def test_one_is_chosen_by_button_by_key_and_in_the_scene_for_all_that_is_beside_it(viewer, endpoints):
    with Runtime(endpoints[0], ARM), Runtime(endpoints[1], HAND), browser(viewer.address) as found:
        found.wait(f"{BOTH} && document.getElementById('touches').innerText.includes('110.')")
        assert "arm" in found.evaluate("document.getElementById('flat-note').innerText")
        found.evaluate("document.querySelectorAll('#skins button')[1].click()")
        found.wait("document.getElementById('touches').innerText.includes('40.')")
        assert "hand" in found.evaluate("document.getElementById('flat-note').innerText")
        found.press("s")
        found.wait("document.getElementById('flat-note').innerText.includes('arm')")
        found.click(*settled_place(found, 110.0, 30.0, 1))
        found.wait("document.getElementById('flat-note').innerText.includes('hand')")
        found.press(" ")  # the time of all stands still
        held = found.evaluate("eitskin.page.skins.map((one) => one.history.shown.t)")
        counts = found.evaluate("eitskin.page.skins.map((one) => one.history.frames.length)")
        for k, had in enumerate(counts):
            found.wait(f"eitskin.page.skins[{k}].history.frames.length > {had} + 3")
        assert found.evaluate("eitskin.page.skins.map((one) => one.history.shown.t)") == held


def test_a_skin_that_does_not_answer_is_shown_so_and_the_rest_goes_on(viewer, endpoints):
    with browser(viewer.address) as found:
        found.wait("document.getElementById('notice')?.innerText.startsWith('arm, hand: no frame from')")
    with Runtime(endpoints[0], ARM), browser(viewer.address) as found:
        found.wait("document.getElementById('state')?.dataset.state === 'part'")
        assert found.evaluate("document.getElementById('state-text').innerText") == "1 of 2 live"
        assert found.evaluate("document.getElementById('notice').innerText").startswith("hand: no frame from")
        assert found.evaluate("document.querySelectorAll('#skins button')[1].dataset.state") == "silent"
        draws_newer(found)
        shot = picture(found)
        grey = pixel(shot, settled_place(found, 75.0, 50.0, 1), 1)
        assert grey.max() - grey.min() < 40  # no colour of the map
        assert grey.min() > 100
        with Runtime(endpoints[1], HAND):
            found.wait("document.getElementById('state').dataset.state === 'live'")
            found.wait("document.getElementById('notice').hidden")
        found.wait("document.getElementById('state').dataset.state === 'part'")
        draws_newer(found)
