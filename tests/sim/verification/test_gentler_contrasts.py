"""Where data tell only the product of size and contrast, maps and ranges say so; elsewhere nothing changes."""

import numpy as np
import pytest
from tests.sim.verification.frames import Array, correlation, flat_verifier, read, shares_of

from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.shapes.parameters import areas_mm2
from eitskin_sim.verification.network_map import map_of
from eitskin_sim.verification.shape_verdict import ShapeVerdict

HARD = np.array([[0, 60.0, 45.0, 12.0, 10.0, 0.0, 50.0, 0.0]])
GENTLE = np.array([[0, 60.0, 45.0, 10.0, 10.0, 0.0, 2.0, 0.0]])


def verified(pieces: Array, kind: TouchKind = "raise", shown: Array | None = None) -> ShapeVerdict:
    return flat_verifier(kind).verify(read(pieces), shares_of(pieces if shown is None else shown), 1000.0)


def test_a_gentle_touch_is_drawn_in_part_and_its_ranges_reach_as_far_as_the_data_allow() -> None:
    found = verified(GENTLE)
    (touch,) = found.touches
    assert len(found.likely) > 1
    assert sum(share for share, _ in found.likely) == pytest.approx(1.0)
    assert np.array_equal(found.likely[0][1], found.pieces)
    truth = map_of(GENTLE)
    assert correlation(found.map(), truth) > correlation(map_of(found.pieces), truth) + 0.02
    assert touch.area_range_mm2[0] < 85.0 < touch.area_range_mm2[1]
    assert touch.contrast_range[0] <= 2.2


def test_a_larger_gentle_touch_is_found_a_contrast_at_a_time() -> None:
    """Each from the one before: 16 mm of contrast 3 come out as a hard touch of two thirds of the side."""
    larger = GENTLE.copy()
    larger[0, [3, 4, 6]] = 16.0, 16.0, 3.0
    found = verified(larger)
    contrasts = [float(pieces[0, 6]) for _, pieces in found.likely]
    assert contrasts[1:] == sorted(contrasts[1:], reverse=True)
    sides = [float(np.sqrt(areas_mm2(pieces)[0])) for _, pieces in found.likely]
    at = int(np.argmin(np.abs(np.log(contrasts) - np.log(3.0))))
    assert sides[0] < 13.0
    assert sides[at] == pytest.approx(16.0, abs=1.0)
    assert correlation(found.map(), map_of(larger)) > correlation(map_of(found.pieces), map_of(larger)) + 0.02


def test_a_hard_touch_has_one_contrast_and_a_press_may_be_gentler() -> None:
    found = verified(HARD)
    assert len(found.likely) == 1
    assert np.array_equal(found.map(), map_of(found.pieces))
    press = np.array([[2, 60.0, 45.0, 16.0, 16.0, 0.0, 0.6, 4.0]])
    softer = verified(press, "lower")
    assert len(softer.likely) == 2
    assert correlation(softer.map(), map_of(press)) > correlation(map_of(softer.pieces), map_of(press))
