"""A field with a known answer: rows that see smooth bumps at places of their own."""

import numpy as np
import pytest

from eitskin.errors import BundleError
from eitskin.model.taught import FOLLOW_FRAMES, TaughtField
from eitskin_proto.skin.grid import Grid

GRID = Grid((150.0, 100.0), (30, 45), (9, 14))
Q, ROWS = 24, 40
RANDOM = np.random.default_rng(5)
SEEN_MM = RANDOM.uniform((0, 0), (150, 100), (Q, 2))
MIX = np.linalg.qr(RANDOM.normal(size=(ROWS, Q)))[0]
STATE = RANDOM.bit_generator.state


@pytest.fixture(autouse=True)
def the_same_noise_in_each_test():
    RANDOM.bit_generator.state = STATE


def response(places_mm):
    """Return (n, q) whitened responses, some 15 times as strong as noise."""
    distance = ((np.asarray(places_mm)[:, None] - SEEN_MM) ** 2).sum(axis=-1)
    return 15.0 * np.exp(-distance / (2.0 * 25.0**2))


def arrays(**changed):
    places = GRID.pixel_centres_mm().reshape(-1, 2)
    inside = np.ones(len(places))
    inside[:45] = 0.0
    ones = {"amplitude_sd": 0.3, "freedom": 20.0, "threshold": 6.0, "spread": 1.0, "logarithm": 1.0}
    field = response(places)
    taught = {"project": 1e3 * MIX, "field": field, "variance": 0.01 * np.ones_like(field), "inside": inside}
    return {**taught, "untouched": np.eye(Q), **{name: np.array(one) for name, one in ones.items()}, **changed}


def frame(field, place_mm=None, amplitude=1.0, noise=1.0, drift=0.0):
    """Fill dV of a frame, whose rows have noise of 1e-3."""
    z = noise * RANDOM.normal(size=Q) + drift
    for one in () if place_mm is None else np.atleast_2d(place_mm):
        z += amplitude * response([one])[0]
    field.change[:] = np.expm1(1e-3 * MIX @ z)


def test_places_and_their_stated_errors_agree_with_the_truth():
    field, places = TaughtField([arrays()], GRID), RANDOM.uniform((20, 20), (130, 80), (300, 2))
    errors = []
    for place in places:
        frame(field, place, amplitude=RANDOM.uniform(0.6, 1.4))
        assert field.look() > field.threshold
        touch = field.strongest()
        errors.append([(touch.x_mm - place[0]) / touch.sd_x_mm, (touch.y_mm - place[1]) / touch.sd_y_mm])
    assert 0.62 < (np.abs(errors) < 1.0).mean() < 0.74  # 68 %, +-2.5 standard deviations of 600
    assert np.abs(np.mean(errors, axis=0)).max() < 0.2


def test_untouched_frames_are_untouched_and_the_map_peaks_at_the_touch():
    field, out = TaughtField([arrays()], GRID), np.zeros(GRID.n_pixels, dtype=np.float32)
    for _ in range(200):
        frame(field)
        assert not field.touched()
    assert field.touches() == []
    frame(field, (61.0, 40.0))
    assert field.touched()
    field.fill_map(out)
    x, y = GRID.pixel_centres_mm().reshape(-1, 2)[out.argmax()]
    assert out.max() == pytest.approx(1.0, abs=1e-5)
    assert np.hypot(x - 61.0, y - 40.0) < 4.0
    assert not out[:45].any()


def test_the_baseline_follows_drift_while_untouched_and_stays_under_a_held_press():
    field = TaughtField([arrays()], GRID)
    drifts = np.linspace(0.0, 10.0, 100 * FOLLOW_FRAMES)  # at once this would be a touch
    for drift in drifts:
        frame(field, drift=drift)
        assert not field.touched()
    for _ in range(100 * FOLLOW_FRAMES):
        frame(field, (75.0, 50.0), drift=drifts[-1])
        assert field.touched()
    (touch,) = field.touches()
    assert np.hypot(touch.x_mm - 75.0, touch.y_mm - 50.0) < 3.0
    frame(field, drift=drifts[-1])
    assert not field.touched()
    field.reset()
    frame(field, drift=drifts[-1])
    assert field.touched()


def test_the_baseline_follows_drift_in_short_rests_between_presses():
    field = TaughtField([arrays()], GRID)
    for drift in np.linspace(0.0, 10.0, 2 * FOLLOW_FRAMES):  # as much in all as would be a touch at once
        for _ in range(FOLLOW_FRAMES // 2):
            frame(field, drift=drift)
            untouched = not field.touched()
        assert untouched
        for _ in range(FOLLOW_FRAMES // 2):
            frame(field, (75.0, 50.0), drift=drift)
            assert field.touched()


def test_a_faint_touch_shows_in_the_average_of_a_still_sheet():
    field, single, alone = TaughtField([arrays()], GRID), TaughtField([arrays()], GRID), 0
    for _ in range(20):
        frame(field, (75.0, 50.0), amplitude=0.2)
        single.change[:] = field.change
        alone += single.look() > single.threshold
        found = field.touched()
    assert alone < 10
    assert found


def test_a_press_in_the_second_frame_is_felt_at_once():
    field = TaughtField([arrays()], GRID)
    frame(field)
    field.touched()
    for _ in range(3):
        frame(field, (75.0, 50.0))
        assert field.touched()
    assert field.strongest().amplitude == pytest.approx(1.0, abs=0.15), "the untouched frame is in no average"


def test_presses_that_change_with_every_frame_are_not_averaged():
    field = TaughtField([arrays()], GRID)
    for place in RANDOM.uniform((20, 20), (50, 80), (100, 2)) + np.tile([(0, 0), (75, 0)], (50, 1)):
        frame(field, place)
        assert field.touched()
        (touch,) = field.touches()
        assert np.hypot(touch.x_mm - place[0], touch.y_mm - place[1]) < 5.0 * max(touch.sd_x_mm, touch.sd_y_mm)


def test_a_hard_press_is_one_touch():
    field = TaughtField([arrays()], GRID)
    frame(field, (75.0, 50.0), amplitude=3.0)
    assert field.touched()
    (touch,) = field.touches()
    assert touch.amplitude > 2.0


@pytest.mark.parametrize(
    "changed",
    [
        {"field": np.zeros((3, Q))},
        {"field": np.full((GRID.n_pixels, Q), np.nan)},
        {"project": np.zeros((ROWS, 200))},
        {"variance": np.full((GRID.n_pixels, Q), -1.0)},
        {"inside": np.zeros(GRID.n_pixels)},
        {"untouched": -np.eye(Q)},
        {"amplitude_sd": np.array(0.0)},
        {"threshold": np.array(["x"])},
    ],
)
def test_a_malformed_field_is_refused(changed):
    with pytest.raises(BundleError, match=r"taught\.npz"):
        TaughtField([arrays(**changed)], GRID)
