"""Touches as the skin's description says: its ways, contrasts, sizes and borders."""

from dataclasses import replace

import numpy as np
import pytest
from tests.second_skin import SECOND

from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import named
from eitskin_sim.freeform.touches import pool_of, ranges_of
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.touch_table import Array

HYDROGEL = named("hydrogel")


def skin(**touches: object) -> Skin:
    return replace(HYDROGEL, touches=replace(HYDROGEL.touches, **touches))  # type: ignore[arg-type]


def drawn(own: Skin, count: int = 320, kind: str = "skin") -> Array:
    return pool_of(kind, count, np.random.default_rng(1), own).pieces


def within(values: Array, bounds: tuple[float, float]) -> bool:
    return bool(np.all((values >= bounds[0] - 1e-9) & (values <= bounds[1] + 1e-9)))


def test_hydrogel_says_what_presses_are() -> None:
    assert np.array_equal(drawn(HYDROGEL), drawn(HYDROGEL, kind="press"))


def test_a_press_of_a_calibrated_stamp_is_drawn_as_it_was_measured() -> None:
    pieces = drawn(skin(lowering_contrast=(0.5, 0.7), size_mm=(10.0, 14.0), border_mm=(2.0, 3.0)))
    assert within(pieces[:, 6], (0.5, 0.7))
    assert np.ptp(np.log(pieces[:, 6])) > 0.9 * np.log(0.7 / 0.5)
    assert within(pieces[:, 3:5], (10.0, 14.0))
    assert within(pieces[:, 7], (2.0, 3.0))


@pytest.mark.parametrize(("border_mm", "sharp"), [((0.0, 0.0), 1.0), ((0.0, 0.3), 1.0), ((1.0, 4.0), 0.0)])
def test_borders_are_sharp_where_the_skin_says_so(border_mm: tuple[float, float], sharp: float) -> None:
    assert np.mean(drawn(skin(border_mm=border_mm))[:, 7] == 0.0) == sharp


def test_both_ways_each_with_its_own_contrasts() -> None:
    pieces = drawn(skin(kind="both", raising_contrast=(3.0, 9.0), lowering_contrast=(0.3, 0.4)))
    lowers = pieces[:, 6] < 1.0
    assert lowers.mean() == 0.5
    assert within(pieces[lowers, 6], (0.3, 0.4))
    assert within(pieces[~lowers, 6], (3.0, 9.0))


def test_a_large_touch_stays_on_a_small_sheet() -> None:
    small = replace(SECOND, touches=replace(HYDROGEL.touches, size_mm=(20.0, 90.0)))
    pieces = drawn(small)
    assert within(pieces[:, 3:5], (20.0, 63.0))
    half = half_extents_mm(pieces)
    assert np.all(pieces[:, 1:3] >= half - 1e-9)
    with pytest.raises(ValueError, match=r"\[touches\] size_mm begins at 65, expected at most 63 on this sheet"):
        ranges_of("skin", replace(small, touches=replace(small.touches, size_mm=(65.0, 70.0))))
