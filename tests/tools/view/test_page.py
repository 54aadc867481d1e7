"""The page in a headless Chromium, in front of a runtime that publishes known scenes."""

import numpy as np
import pytest

from eitskin.robot.pose import Pose
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.view.messages import packed, surface_message
from eitskin_tools.view.source import Source
from eitskin_tools.view.viewer import Viewer

from .chromium import PROGRAM
from .conftest import browser, draws_newer, flat_place, picture, pixel, settled_place, space_place
from .scripted import Runtime, Scene, cylinder, disc, flat

pytestmark = [
    pytest.mark.process,
    pytest.mark.slow,
    pytest.mark.skipif(PROGRAM is None, reason="no Chromium: tools/system-packages.sh chromium"),
]

TOUCHED = disc(110.0, 30.0)
SHOWN = "window.eitskin && eitskin.page.drawings > 0 && eitskin.history.newest"


def test_the_touch_is_bright_where_it_is_and_the_rest_is_dark_flat_and_bent(viewer, endpoint):
    with Runtime(endpoint, Scene(TOUCHED)) as runtime, browser(viewer.address) as found:
        found.wait(f"{SHOWN} && eitskin.history.shown.head.touches.length")
        shot = picture(found)
        for place in (flat_place, space_place):
            assert pixel(shot, place(found, 110.0, 25.5)).min() > 130  # below the centre, where the arrow begins
            assert pixel(shot, place(found, 40.0, 70.0)).max() < 90
        bent = cylinder()
        viewer.board.post("surface", surface_message(3, bent, "one", 0, Pose()))
        runtime.scene = Scene(TOUCHED, cloud=3, cloud_mm=bent)
        found.wait("eitskin.history.shown.surface.revision === 3")
        found.wait("eitskin.history.shown.head.cloud === 3")
        lit = settled_place(found, 110.0, 25.5)
        shot = picture(found)
        assert pixel(shot, lit, 1).min() > 110
        assert pixel(shot, space_place(found, 60.0, 70.0), 1).max() < 100
        height = found.evaluate("eitskin.history.shown.surface.at(110, 30).place[2]")
        turn = (110.0 - 75.0) / (150.0 / np.deg2rad(120.0))
        assert height == pytest.approx(150.0 / np.deg2rad(120.0) * (np.cos(turn) - 1.0), abs=0.1)  # of the polygon
        row = found.evaluate("document.querySelector('#touches tr').innerText.split(/\\s+/)")
        assert (float(row[1].rstrip(",")), float(row[2])) == pytest.approx((110.0, 30.0), abs=0.2)
        assert float(row[3]) == pytest.approx(np.pi * 64, rel=0.1)


def test_another_size_a_phone_and_the_dark_are_drawn_anew_and_nothing_sticks_out(viewer, endpoint):
    with Runtime(endpoint, Scene(TOUCHED)), browser(viewer.address) as found:
        found.wait(SHOWN)
        light = picture(found)
        assert pixel(light, (900, 22)).mean() > 200
        found.wear(dark=True)
        draws_newer(found)
        assert pixel(picture(found), (900, 22)).mean() < 60
        found.evaluate("document.getElementById('theme').click()")  # light, whatever the system says
        draws_newer(found)
        assert pixel(picture(found), (900, 22)).mean() > 200
        for width, height in ((1280, 720), (900, 700), (1920, 1080), (390, 844), (320, 640)):
            found.resize(width, height, mobile=width < 500)
            found.wait(f"innerWidth === {width}")
            draws_newer(found)
            assert found.evaluate("document.documentElement.scrollWidth") <= width, (width, height)
            drawn = found.evaluate(
                "['scene', 'overlay', 'flat', 'strip-touches', 'strip-drift'].map((id) => { const c = "
                "document.getElementById(id), b = c.getBoundingClientRect(); return [c.width - Math.round(b.width), "
                "c.height - Math.round(b.height), Math.min(b.width, b.height)]; })"
            )
            assert all(abs(wide) <= 1 and abs(high) <= 1 and least > 60 for wide, high, least in drawn), drawn
        found.resize(1280, 720)
        found.wait("innerWidth === 1280")
        assert found.evaluate("document.documentElement.scrollHeight") <= 720


def test_the_page_says_that_nobody_is_there_and_goes_on_when_somebody_comes_and_comes_again(viewer, endpoint):
    with browser(viewer.address) as found:
        found.wait("document.getElementById('notice')?.hidden === false")
        assert "eitskin run" in found.evaluate("document.getElementById('notice').innerText")
        assert found.evaluate("document.getElementById('state').dataset.state") == "silent"
        assert found.evaluate("document.getElementById('electrodes').innerText") == "Unknown."
        for run in ("one", "two"):
            with Runtime(endpoint, Scene(TOUCHED), run=run):
                found.wait(f"eitskin.history.newest?.head.run === {run!r} && document.getElementById('notice').hidden")
                found.wait("document.getElementById('state').dataset.state === 'live'")
            found.wait("document.getElementById('state').dataset.state === 'silent'")
        found.wait("document.getElementById('log').innerText.includes('restarted')")


def test_the_page_comes_back_with_the_viewer_and_wants_its_token(endpoint):
    with Runtime(endpoint, Scene(TOUCHED)), Viewer([Source(PAPER, endpoint)]) as first:
        port = first.server.port
        with browser(first.address) as found:
            found.wait(SHOWN)
            first.__exit__()
            found.wait("document.getElementById('state').dataset.state === 'gone'")
            with Viewer([Source(PAPER, endpoint)], port=port) as second:
                found.wait("document.getElementById('notice').innerText.includes('token')")
                second.server.token = first.server.token
                found.wait("document.getElementById('state').dataset.state === 'live'")
            found.said = [text for text in found.said if "401" not in text]


def test_time_stands_still_steps_and_goes_on_by_keys_and_the_surface_turns(viewer, endpoint):
    with Runtime(endpoint, Scene(TOUCHED)), browser(viewer.address) as found:
        found.wait(f"{SHOWN} && eitskin.history.frames.length > 10")
        found.press(" ")
        at = found.evaluate("[eitskin.history.mode, eitskin.history.shown.t]")
        assert at[0] == "paused"
        draws = found.evaluate("eitskin.history.frames.length")
        found.wait(f"eitskin.history.frames.length > {draws} + 3")
        assert found.evaluate("eitskin.history.shown.t") == at[1]
        found.press(",")
        assert found.evaluate("eitskin.history.shown.t") < at[1]
        found.press(".")
        assert found.evaluate("eitskin.history.shown.t") == at[1]
        found.evaluate("(() => { const s = document.getElementById('scrub'); s.value = 0; "
                       "s.dispatchEvent(new Event('input')); })()")  # fmt: skip
        assert found.evaluate("eitskin.history.shown === eitskin.history.oldest")
        found.wait("document.getElementById('when').innerText.endsWith('ago')")
        found.press(" ")
        assert found.evaluate("eitskin.history.mode") == "playing"
        found.press("l")
        assert found.evaluate("eitskin.history.mode") == "live"
        before = found.evaluate("eitskin.camera.yaw")
        found.evaluate("document.getElementById('scene').focus()")
        found.press("ArrowLeft")
        turned = found.evaluate("eitskin.camera.yaw")
        assert turned != before
        x, y = space_place(found, 75.0, 50.0)
        found.drag(x, y, 60, 0)
        assert found.evaluate("eitskin.camera.yaw") < turned
        found.press("2")
        assert found.evaluate("eitskin.camera.pitch") > 1.5
        found.press("?")
        assert found.evaluate("document.getElementById('keys').open")
        found.press("Escape")
        found.wait("!document.getElementById('keys').open")
        found.press("t")
        assert found.evaluate("document.documentElement.dataset.theme") == "light"


def test_every_button_can_be_reached_by_the_keyboard_and_has_a_name(viewer, endpoint):
    with Runtime(endpoint, Scene(TOUCHED)), browser(viewer.address) as found:
        found.wait(SHOWN)
        met = set()
        for _ in range(30):
            found.press("Tab")
            met.add(found.evaluate("document.activeElement.id || document.activeElement.dataset.view || ''"))
        assert {"theme", "help", "scene", "tilted", "above", "front", "closer", "pause", "back", "scrub"} <= met
        nameless = found.evaluate(
            "[...document.querySelectorAll('button, input, canvas:not([aria-hidden])')].filter((node) => !node.hidden "
            "&& !(node.getAttribute('aria-label') || node.innerText.trim())).map((node) => node.id)"
        )
        assert nameless == []


def test_losses_saved_computation_faulty_electrodes_and_drift_are_shown_in_words(viewer, endpoint):
    scene = Scene(flat()[2], electrodes=("5:detached:imputed",), skipped=("inference:untouched",), counts=(0, 0, 0, 0))
    with Runtime(endpoint, scene) as runtime, browser(viewer.address) as found:
        found.wait(SHOWN)
        found.wait("document.getElementById('electrodes').innerText.includes('5 is detached')")
        found.wait("document.getElementById('skipped').innerText.includes('nothing touches')")
        assert found.evaluate("document.getElementById('losses-now').innerText") == "none"
        found.wait("document.getElementById('drift-now').innerText === '+0.4 ± 0.1 %'")
        runtime.scene = Scene(flat()[2], events=("withheld:stuck",), counts=(7, 0, 1, 0))
        found.wait("document.getElementById('log').innerText.includes('7 frames lost on the wire')")
        found.wait("document.getElementById('log').innerText.includes('Frame withheld: identical rows')")
        found.wait("document.getElementById('losses-now').innerText === '7 lost, 1 withheld'")
        found.wait("document.getElementById('electrodes').innerText.includes('All 16 electrodes work')")
        runtime.scene = Scene(TOUCHED, counts=(7, 0, 1, 0))
        found.wait("document.getElementById('drift-now').innerText === 'unknown while touched'")
    with Runtime(endpoint, Scene(counts=(92, 0, 0, 0)), run="two"), browser(viewer.address) as found:
        found.wait(f"{SHOWN} && document.getElementById('facts').innerText.includes('92')")
        assert found.evaluate("document.getElementById('losses-now').innerText") == "none", "the chart shows none"


def test_the_legend_says_what_the_values_of_the_bundle_mean(viewer, endpoint):
    with Runtime(endpoint, Scene(TOUCHED)), browser(viewer.address) as found:
        found.wait(SHOWN)
        for labels, words in (("area", "touched share of a pixel"), ("units", "probability that a unit is touched")):
            state = {"kind": "state", "of": 0, "n": 1, "run": "one", "events": [], "labels": labels}
            viewer.board.post("state", packed(state))
            found.wait(f"document.getElementById('bar-words').innerText === {words!r}")


def test_the_mouse_comes_closer_goes_to_moments_and_reads_values(viewer, endpoint):
    with browser(viewer.address) as found:
        with Runtime(endpoint, Scene(TOUCHED)):
            found.wait(f"{SHOWN} && eitskin.history.shown.head.touches.length")
            found.wait("eitskin.history.end - eitskin.history.begin > 3000")
        found.wait("document.getElementById('state').dataset.state === 'silent'")  # now nothing moves
        x, y = space_place(found, 40.0, 70.0)
        found.wheel(x, y, -200)
        found.wheel(x, y, -200, ctrl=True)
        found.wait("eitskin.camera.zoom > 1")
        zoom = found.evaluate("eitskin.camera.zoom")
        assert zoom == pytest.approx(np.exp(0.3)), "without Ctrl the page scrolls until the surface was clicked"
        found.press("l")
        left, width, at_y = found.evaluate(
            "(() => { const b = document.getElementById('strip-touches').getBoundingClientRect(); "
            "return [b.left, b.width, b.top + b.height / 2]; })()"
        )
        begin, room = left + 34, width - 36  # static/strips.js: the numbers stand on the left
        at_x, end_ms = round(begin + room * (1 - 1500 / 60000)), found.evaluate("eitskin.history.end")
        found.click(at_x, at_y)
        found.wait("eitskin.clock.mode === 'paused'")
        asked_ms = end_ms - 60000 * (1 - (at_x - begin) / room)
        assert found.evaluate("eitskin.clock.at") == pytest.approx(asked_ms, abs=60000 / room)
        found.move(*flat_place(found, 110.0, 30.0))
        found.wait("document.getElementById('flat').title.endsWith(': 1.00')")
