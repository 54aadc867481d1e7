"""Scripted touches: each keeps its number while it moves, and what begins and ends is said."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.errors import FrameError
from eitskin.touches.surface import Surface
from eitskin.touches.touch import LAYOUT, UNKNOWN, unpack_touches
from eitskin.touches.tracking import HOLD_FRAMES
from eitskin.touches.watch import TouchWatch

from .scripted import GRID, box, square

FLAT = Surface(GRID.flat_cloud_mm(), GRID)


class Film:
    """A watch that is shown one map after another, 5 ms apart."""

    def __init__(self):
        self.watch, self.frame = TouchWatch(GRID), 0

    def show(self, image, which=None):
        self.frame += 1
        values = None if image is None else image.astype(np.float32).ravel()
        packed = self.watch.update(values, which or self.frame, FLAT, 5000 * self.frame)
        return unpack_touches(packed[0], LAYOUT.size, *packed[1:])


@pytest.fixture
def film():
    return Film()


def said(found):
    return [(event.kind, event.id, event.other) for event in found.events]


def ids(found):
    return [touch.id for touch in found.touches]


def test_a_touch_keeps_its_number_while_it_moves_and_grows_older(film):
    first = film.show(square(20.0, 50.0))
    assert said(first) == [("born", 1, 0)]
    assert first.touches[0].age_s == 0.0
    for step in range(1, 12):
        found = film.show(square(20.0 + 9.0 * step, 50.0))
        assert ids(found) == [1]
        assert found.events == ()
        assert found.touches[0].age_s == pytest.approx(0.005 * step)
        assert found.touches[0].centre_mm[0] == pytest.approx(20.0 + 9.0 * step, abs=0.05)


def test_two_touches_that_pass_each_other_keep_their_numbers(film):
    seen = [film.show(square(20 + 4 * k, 30.0) + square(130 - 4 * k, 60.0)) for k in range(27)]
    assert all(ids(found) == [1, 2] and (k == 0 or not found.events) for k, found in enumerate(seen))
    assert [touch.centre_mm[1] < 45 for touch in seen[-1].touches] == [True, False]


def test_two_that_meet_merge_and_two_that_part_split(film):
    for gap in (30.0, 24.0, 18.0):
        found = film.show(square(75 - gap / 2, 50.0) + square(75 + gap / 2, 50.0))
        assert ids(found) == [1, 2]
    found = film.show(box(66.0, 45.0, 84.0, 55.0))
    assert said(found) == [("merged", 2, 1)]
    assert ids(found) == [1]
    found = film.show(square(66.0, 50.0) + square(85.0, 50.0))
    assert said(found) == [("split", 3, 1)]
    assert ids(found) == [1, 3]
    assert [touch.parent for touch in found.touches] == [0, 1]
    assert not film.show(square(65.0, 50.0) + square(86.0, 50.0)).events


def test_a_touch_that_flickers_keeps_its_number_and_one_that_stays_away_dies(film):
    film.show(square(50.0, 50.0))
    for _ in range(HOLD_FRAMES):
        gone = film.show(None)
        assert (gone.touches, gone.events) == ((), ())
    assert ids(film.show(square(52.0, 50.0))) == [1]
    ends = [said(film.show(np.zeros(GRID.shape))) for _ in range(HOLD_FRAMES + 2)]
    assert ends == [[]] * HOLD_FRAMES + [[("died", 1, 0)], []]
    assert said(film.show(square(52.0, 50.0))) == [("born", 2, 0)]


def test_a_faint_touch_is_not_new_but_one_that_fades_goes_on(film):
    assert film.show(0.55 * square(50.0, 50.0)).touches == ()
    assert ids(film.show(0.7 * square(50.0, 50.0))) == [1]
    assert ids(film.show(0.55 * square(50.0, 50.0))) == [1]


def test_noise_for_ever_gives_bounded_lists_and_no_number_twice(film):
    rng = np.random.default_rng(0)
    born, ended = set(), set()
    for _ in range(150):
        found = film.show(rng.random(GRID.shape) ** rng.choice([1.0, 4.0, 8.0]))
        assert len(found.touches) <= 16
        for event in found.events:
            if event.kind in ("born", "split"):
                assert event.id not in born
                born.add(event.id)
            else:
                assert event.id in born - ended
                ended.add(event.id)
        assert set(ids(found)) <= born - ended
    assert len(ended) > 50


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ((b"x" * 75, 76, b"", 0), "touches: expected 76 bytes for each"),
        ((b"", 20, b"", 0), "touch_bytes: found 20"),
        ((b"", 76, b"abc", 0), "touch_events: expected 12"),
        ((b"", 76, b"", -1), "touches_more: found -1"),
        ((None, 76, b"", 0), "touches: expected"),
        ((UNKNOWN, LAYOUT.size, b"", 0), "touch 0 has values that are not finite"),
        ((b"\0" * 76 * 60, 76, b"", 0), "at most 4096"),
    ],
)
def test_a_malformed_list_is_named(values, named):
    with pytest.raises(FrameError, match=named):
        unpack_touches(*values)


@pytest.mark.parametrize(("kind", "sign"), [("raise", 1), ("lower", -1), ("both", None)])
def test_a_touch_has_the_sign_that_its_network_knows_and_of_older_runtimes_none(kind, sign):
    packed = TouchWatch(GRID, kind=kind).update(square(50.0, 50.0).ravel(), 1, FLAT, 0)
    (now,) = unpack_touches(packed[0], LAYOUT.size, *packed[1:]).touches
    assert now.sign == sign
    for size in (76, 92):
        (older,) = unpack_touches(packed[0][:size], size, *packed[1:]).touches
        assert older == replace(now, sign=None, velocity_mm_s=None)
        assert older.error_mm is older.amplitude is None


def moved(film, steps_mm, noise_mm, seed=1):
    """Show a touch that goes so far in each frame, with noise of its place; return its true and listed places."""
    rng, truth, found = np.random.default_rng(seed), 30.0 + np.cumsum(steps_mm), []
    for x in truth:
        dx, dy = noise_mm * rng.standard_normal(2)
        found.append(film.show(square(x + dx, 50.0 + dy)).touches[0])
    return truth, found


def test_a_touch_that_slides_is_nearer_than_what_frames_show_and_no_later(film):
    truth, found = moved(film, np.full(200, 0.25), 0.5)
    late = truth[40:] - [touch.centre_mm[0] for touch in found[40:]]
    assert np.std(late) < 0.5 * 0.6
    assert np.mean(late) < 0.25  # 5 ms
    assert np.mean([touch.velocity_mm_s for touch in found[40:]], axis=0) == pytest.approx((50.0, 0.0), abs=5.0)


def test_a_touch_that_turns_round_is_followed_within_a_few_frames(film):
    truth, found = moved(film, np.concatenate([np.full(100, 0.6), np.full(60, -0.6)]), 0.2)
    apart = np.abs(truth - [touch.centre_mm[0] for touch in found])
    assert apart.max() < 3.0
    assert apart[112:].mean() < 0.3


def test_a_fast_touch_that_stops_within_100_ms_is_not_shown_beyond_its_place(film):
    steps = np.concatenate([np.full(70, 1.0), np.linspace(1.0, 0.0, 20), np.zeros(40)])
    truth, found = moved(film, steps, 0.4)
    apart = np.abs(truth - [touch.centre_mm[0] for touch in found])
    assert apart[90:].max() < 3.0


@pytest.mark.parametrize("period_us", [0, 200_000])
def test_a_touch_is_where_frames_show_it_if_frames_are_rare_or_the_clock_stands_still(period_us):
    watch = TouchWatch(GRID)
    for frame, x in enumerate(np.arange(30.0, 100.0)):
        image = square(x, 50.0).astype(np.float32).ravel()
        packed = watch.update(image, frame, FLAT, period_us * frame)
        (touch,) = unpack_touches(packed[0], LAYOUT.size, *packed[1:]).touches
        assert touch.centre_mm[0] == pytest.approx(x, abs=0.5)


def test_a_clock_that_jumps_moves_no_touch(film):
    moved(film, np.full(50, 0.25), 0.1)
    watch, image = film.watch, square(42.5, 50.0).astype(np.float32).ravel()
    for which, device_us in enumerate((10**9, 5, 10**12, 10**12, 6), 1000):
        packed = watch.update(image, which, FLAT, device_us)
        (touch,) = unpack_touches(packed[0], LAYOUT.size, *packed[1:]).touches
        assert np.hypot(touch.centre_mm[0] - 42.5, touch.centre_mm[1] - 50.0) < 0.5
