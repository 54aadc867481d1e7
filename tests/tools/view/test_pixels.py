"""Pixels of what is drawn and written over both maps, of scenes whose every place and number is known.

Places are computed here, from the bend and the map's disc; the page is asked only where it shows a place in space.
"""

import numpy as np
import pytest

from eitskin.robot.pose import Pose
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.view.messages import electrode_places_mm, surface_message

from .chromium import PROGRAM
from .conftest import browser, draws_newer, flat_place, ink, picture, pixel, settled_place
from .scripted import Runtime, Scene, cylinder, disc, flat

pytestmark = [
    pytest.mark.process,
    pytest.mark.slow,
    pytest.mark.skipif(PROGRAM is None, reason="no Chromium: tools/system-packages.sh chromium"),
]

X_MM, Y_MM, RADIUS_MM, ARROW_MM, ANGLE_DEG = 110.0, 30.0, 8.0, 20.0, 120.0
TOUCHED = disc(X_MM, Y_MM, RADIUS_MM)
SHOWN = "window.eitskin && eitskin.page.drawings > 0 && eitskin.history.newest"


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


NOTES_WHAT_IS_WRITTEN = """(() => {
  window.written = [];
  const { prototype } = CanvasRenderingContext2D, write = prototype.fillText;
  prototype.fillText = function (text, x, y, ...more) {
    const { left, top } = this.canvas.getBoundingClientRect();
    const at = this.getTransform().transformPoint(new DOMPoint(x, y)); // a pixel of the canvas is one of the screen
    window.written.push([this.canvas.id, text, left + at.x, top + at.y]);
    return write.call(this, text, x, y, ...more);
  };
})()"""


def far(text_at, place):
    """Return how far something that was written lies from a place, in pixels."""
    return np.hypot(*np.subtract(text_at, place))


def sheet_edges(found, shot):
    """Return left, right, top and bottom of the sheet as it is drawn: untouched pixels are dark, the card is light."""
    (x, _), (_, y) = flat_place(found, 60.0, 70.0), flat_place(found, 40.0, 35.0)  # no electrode in their way
    box = found.evaluate(
        "(() => { const b = document.getElementById('flat').getBoundingClientRect(); "
        "return [b.left, b.right, b.top, b.bottom].map(Math.round); })()"
    )
    across = np.flatnonzero(shot[round(y), box[0] : box[1]].max(axis=1) < 128) + box[0]
    along = np.flatnonzero(shot[box[2] : box[3], round(x)].max(axis=1) < 128) + box[2]
    return across[0], across[-1] + 1, along[0], along[-1] + 1


def test_axes_are_in_mm_electrodes_have_numbers_and_health_and_touches_their_numbers(viewer, endpoint):
    electrodes = electrode_places_mm(PAPER)
    with (
        Runtime(endpoint, Scene(TOUCHED, electrodes=("5:detached:imputed",))),
        browser(viewer.address) as found,
    ):
        found.wait(f"{SHOWN} && eitskin.history.shown.head.touches.length")
        settled_place(found, X_MM, Y_MM)
        found.evaluate(NOTES_WHAT_IS_WRITTEN)
        draws_newer(found)
        shot, written = picture(found), found.evaluate("written")
        touch = str(found.evaluate("eitskin.history.shown.head.touches[0].id"))

        def places(canvas, text):
            return [(x, y) for name, said, x, y in written if (name, said) == (canvas, text)]

        left, right, top, bottom = sheet_edges(found, shot)
        corners = [*flat_place(found, 0.0, 0.0), *flat_place(found, 150.0, 100.0)]
        assert corners == pytest.approx([left, bottom, right, top], abs=2.0), "the mapping is that of the picture"
        ticks_x = {mm: flat_place(found, mm, 0.0)[0] for mm in range(0, 151, 25)}
        ticks_y = {mm: flat_place(found, 0.0, mm)[1] for mm in range(0, 101, 25)}
        for mm, at in ticks_x.items():
            assert any(abs(x - at) <= 1 and bottom + 20 < y < bottom + 40 for x, y in places("flat", str(mm))), mm
        for mm, at in ticks_y.items():
            assert any(abs(y - at) <= 1 and left - 45 < x < left - 20 for x, y in places("flat", str(mm))), mm
        ((x, y),) = set(places("flat", "x, mm"))
        assert x == pytest.approx((left + right) / 2, abs=2)
        assert y > bottom + 40
        ((x, y),) = set(places("flat", "y, mm"))
        assert y == pytest.approx((top + bottom) / 2, abs=2)
        assert x < left - 45

        good, warn = ink(found, "good"), ink(found, "warn")
        assert np.abs(good - warn).max() > 60
        for number, (x_mm, y_mm) in enumerate(electrodes):
            flat_at, space_at = flat_place(found, x_mm, y_mm), on_screen(found, on_the_flat(x_mm, y_mm)[0])
            assert any(far(one, flat_at) == pytest.approx(14.0, abs=1.0) for one in places("flat", str(number)))
            assert any(5.0 < far(one, space_at) < 25.0 for one in places("overlay", str(number)))
            for x, y in (flat_at, space_at):
                middle, corner = pixel(shot, (x, y), 1), pixel(shot, (x, y - 4), 0)
                np.testing.assert_allclose(middle, warn if number == 5 else good, atol=12, err_msg=str(number))
                assert (np.abs(corner - (warn if number == 5 else good)).max() < 12) == (number == 5), "a diamond, dots"

        radius_px = RADIUS_MM * (right - left) / 150.0
        x, y = flat_place(found, X_MM, Y_MM)
        assert any(far(one, (x, y - radius_px - 13)) < 3 for one in places("flat", touch))
        place, normal = on_the_flat(X_MM, Y_MM)
        foot, tip = on_screen(found, place), on_screen(found, place + ARROW_MM * normal)
        beyond = np.add(tip, 16 * np.subtract(tip, foot) / far(tip, foot))
        assert any(far(one, beyond) < 3 for one in places("overlay", touch))


def test_the_surface_of_a_scene_without_a_cloud_is_the_flat_sheet(viewer, endpoint):
    with Runtime(endpoint, Scene(flat()[2])), browser(viewer.address) as found:
        found.wait(SHOWN)
        draws_newer(found)
        corners = found.evaluate(
            "[[0, 0], [150, 0], [150, 100]].map(([x, y]) => eitskin.page.one.drawn.at(x, y).place)"
        )
        np.testing.assert_allclose(corners, [[0, 0, 0], [150, 0, 0], [150, 100, 0]], atol=0.1)
