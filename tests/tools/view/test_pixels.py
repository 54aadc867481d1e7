"""Pixels of what is written over the surface and of the time strips, of scenes whose every place and number is known.

Places are computed here, from the bend and the map's disc; the page is asked only where it shows a place in space.
"""

import numpy as np
import pytest

from eitskin.robot.pose import Pose
from eitskin_tools.view.messages import surface_message

from .chromium import PROGRAM
from .conftest import browser, draws_again, draws_newer, flat_place, picture, settled_place
from .scripted import Runtime, Scene, cylinder, disc, flat

pytestmark = [
    pytest.mark.process,
    pytest.mark.slow,
    pytest.mark.skipif(PROGRAM is None, reason="no Chromium: tools/system-packages.sh chromium"),
]

X_MM, Y_MM, RADIUS_MM, ARROW_MM, ANGLE_DEG = 110.0, 30.0, 8.0, 20.0, 120.0
TOUCHED = disc(X_MM, Y_MM, RADIUS_MM)
SHOWN = "window.eitskin && eitskin.page.drawings > 0 && eitskin.history.newest"
PAD = {"left": 34, "right": 2, "top": 7, "bottom": 15}
"""Of a strip, in CSS pixels: static/strips.js."""
PHASE_MS = 3000
"""How long each half of the strips' scene lasts: 15 of their pixels."""


def on_screen(found, place):
    """Return where a place in space, in mm, lies on the screen."""
    return found.evaluate(
        "(() => { const b = document.getElementById('overlay').getBoundingClientRect(), [x, y] = "
        f"eitskin.page.project({[float(value) for value in place]}); return [b.left + x, b.top + y]; }})()"
    )


def whitest(shot, place):
    """Return how white the whitest pixel about a place is: its least channel."""
    x, y = (round(value) for value in place)
    return shot[y - 1 : y + 2, x - 1 : x + 2].min(axis=2).max()


def on_the_bend(x_mm, y_mm):
    """Return the place of a point of the sheet bent about y, and the direction in which it faces there."""
    radius = 150.0 / np.deg2rad(ANGLE_DEG)
    turn = (x_mm - 75.0) / radius
    place = np.array([75.0 + radius * np.sin(turn), y_mm, radius * np.cos(turn) - radius])
    return place, np.array([np.sin(turn), 0.0, np.cos(turn)])


def on_the_flat(x_mm, y_mm):
    return np.array([x_mm, y_mm, 0.0]), np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("bent", [False, True])
def test_where_a_touch_is_stand_its_ring_and_an_arrow_along_the_surfaces_normal(viewer, endpoint, bent):
    cloud = {"cloud": 3, "cloud_mm": cylinder(ANGLE_DEG)} if bent else {}
    at = on_the_bend if bent else on_the_flat
    place, normal = at(X_MM, Y_MM)
    ring = [at(X_MM + RADIUS_MM * np.cos(a), Y_MM + RADIUS_MM * np.sin(a))[0] for a in np.arange(8) * np.pi / 4]
    with Runtime(endpoint, Scene(**cloud)) as runtime, browser(viewer.address, dark=True) as found:
        found.wait(SHOWN)
        if bent:
            viewer.board.post("surface", surface_message(3, cloud["cloud_mm"], "one", 0, Pose()))
            found.wait("eitskin.history.shown.surface.revision === 3")
        settled_place(found, X_MM, Y_MM)
        shaft = [on_screen(found, place + share * ARROW_MM * normal) for share in (0.55, 0.7, 0.85)]
        rim = [on_screen(found, one) for one in ring]
        assert np.hypot(*np.subtract(shaft[2], shaft[0])) > 4, "the arrow does not point at the eye"
        bare = picture(found)
        runtime.scene = Scene(TOUCHED, **cloud)
        found.wait("eitskin.history.shown.head.touches.length === 1")
        draws_newer(found)
        shot = picture(found)
        assert all(whitest(bare, one) < 150 for one in (*shaft, *rim)), "nothing is drawn where nothing touches"
        assert all(whitest(shot, one) > 200 for one in shaft), [whitest(shot, one) for one in shaft]
        assert sum(whitest(shot, one) > 200 for one in rim) >= 6, [whitest(shot, one) for one in rim]
        told = found.evaluate("eitskin.history.shown.head.touches[0]")
        if bent:  # the surface was posted to the page alone, so the touch does not say where it is in space
            assert told["normal"] == [0, 0, 0]
        else:
            assert told["normal"] == pytest.approx(normal.tolist(), abs=0.03)
            assert told["place"] == pytest.approx(place.tolist(), abs=0.4)
        runtime.scene = Scene(**cloud)
        found.wait("eitskin.history.shown.head.touches.length === 0")
        draws_newer(found)
        shot = picture(found)
        assert all(whitest(shot, one) < 150 for one in shaft)


def test_a_touch_has_its_ring_on_the_flat_map(viewer, endpoint):
    with Runtime(endpoint, Scene(TOUCHED)) as runtime, browser(viewer.address, dark=True) as found:
        found.wait(f"{SHOWN} && eitskin.history.shown.head.touches.length")
        draws_newer(found)
        rim = [
            flat_place(found, X_MM + RADIUS_MM * np.cos(a), Y_MM + RADIUS_MM * np.sin(a))
            for a in np.arange(8) * np.pi / 4 + 0.2  # beside the number, which stands above
        ]
        shot = picture(found)
        assert sum(whitest(shot, one) > 200 for one in rim) >= 6
        runtime.scene = Scene()
        found.wait("eitskin.history.shown.head.touches.length === 0")
        draws_newer(found)
        shot = picture(found)
        assert all(whitest(shot, one) < 150 for one in rim)


def nice(value):
    """Return the next of 1, 2, 5 times a power of ten, as an axis ends."""
    power = 10.0 ** np.floor(np.log10(value))
    return power * next(step for step in (1, 2, 5, 10) if step * power >= value * 0.999)


def ink(found, name):
    """Return a colour of the style sheet, (3,)."""
    text = found.evaluate(f"getComputedStyle(document.documentElement).getPropertyValue('--{name}').trim()")
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)], dtype=float)


def columns(found, shot, strip, begin_ms, end_ms):
    """Return (rows, columns, 3): a strip from one time to another."""
    left, top, width, height, begin, end = found.evaluate(
        f"(() => {{ const b = document.getElementById('{strip}').getBoundingClientRect(), w = "
        "eitskin.history.window(b.width); return [b.left, b.top, b.width, b.height, w.begin, w.end]; })()"
    )
    room = width - PAD["left"] - PAD["right"]
    ends = [round(left + PAD["left"] + (t - begin) / (end - begin) * room) for t in (begin_ms, end_ms)]
    return shot[round(top) : round(top + height), ends[0] : ends[1] + 1]


def line_rows(strip, colour):
    """Return of each column the mean row of its pixels of a colour, NaN without one."""
    like = np.abs(strip - colour).max(axis=2) < 60
    rows = np.arange(len(strip))[:, None]
    return np.where(like.any(axis=0), (like * rows).sum(axis=0) / np.maximum(like.sum(axis=0), 1), np.nan)


def row_of(height, value, low, high):
    """Return the row in which a strip shows a value."""
    return height - PAD["bottom"] - (value - low) / (high - low) * (height - PAD["top"] - PAD["bottom"])


def test_the_strips_show_when_it_was_touched_what_was_lost_how_long_it_took_and_the_drift(viewer, endpoint):
    spans = Scene().spans_us
    with browser(viewer.address) as found:
        with Runtime(endpoint, Scene(drift=(0.4, 0.1, 0.2))) as runtime:
            found.wait(f"{SHOWN} && eitskin.history.end - eitskin.history.begin > {PHASE_MS}")
            changed_ms = found.evaluate("eitskin.history.end")
            runtime.scene = Scene(TOUCHED, drift=(2.0, 0.1, 0.2), counts=(7, 0, 0, 0))
            found.wait(f"eitskin.history.newest.head.touches.length && eitskin.history.end > {changed_ms + PHASE_MS}")
        found.wait("document.getElementById('state').dataset.state === 'silent'")  # now nothing moves
        found.evaluate("eitskin.page.slowAt = 0")
        draws_again(found)
        shot, end_ms = picture(found), found.evaluate("eitskin.history.end")
        area = found.evaluate("eitskin.history.newest.head.touches[0].area")
        before, after = (changed_ms - 2000, changed_ms - 700), (end_ms - 1800, end_ms - 500)

        strips = {"touches": ("s1", 0.0, area, 0.0, nice(area)), "drift": ("s3", 0.4, 2.0, -1.0, nice(2.1))}
        for name, (colour, low_value, high_value, low, high) in strips.items():
            for span, value in ((before, low_value), (after, high_value)):
                strip = columns(found, shot, f"strip-{name}", *span)
                rows = line_rows(strip, ink(found, colour))
                assert np.isfinite(rows).all(), (name, span)
                np.testing.assert_allclose(rows, row_of(len(strip), value, low, high), atol=2.0, err_msg=name)

        strip = columns(found, shot, "strip-latency", *after)
        total_ms = sum(spans) / 1000
        top = row_of(len(strip), total_ms, 0.0, nice(1.1 * total_ms))
        filled = np.abs(strip - ink(found, "card")).max(axis=2) > 70
        assert filled[round(top) + 2 : len(strip) - PAD["bottom"] - 2].mean() > 0.9
        assert filled[PAD["top"] + 3 : round(top) - 2].mean() < 0.1

        strip = columns(found, shot, "strip-losses", changed_ms - 1100, end_ms)  # a bar is of a whole second
        lost = np.abs(strip - ink(found, "s4")).max(axis=2) < 60
        tall = row_of(len(strip), 0.0, 0.0, nice(7)) - row_of(len(strip), 7.0, 0.0, nice(7))
        assert lost.sum(axis=0).max() == pytest.approx(tall, abs=2.0)
        strip = columns(found, shot, "strip-losses", changed_ms - 2500, changed_ms - 1100)
        assert not (np.abs(strip - ink(found, "s4")).max(axis=2) < 60).any()


def test_the_surface_of_a_scene_without_a_cloud_is_the_flat_sheet(viewer, endpoint):
    with Runtime(endpoint, Scene(flat()[2])), browser(viewer.address) as found:
        found.wait(SHOWN)
        draws_newer(found)
        corners = found.evaluate(
            "[[0, 0], [150, 0], [150, 100]].map(([x, y]) => eitskin.page.one.drawn.at(x, y).place)"
        )
        np.testing.assert_allclose(corners, [[0, 0, 0], [150, 0, 0], [150, 100, 0]], atol=0.1)
