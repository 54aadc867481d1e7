"""Touches as the skin's description says: its ways, contrasts, sizes and borders."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import named
from eitskin_sim.arrays import Array
from eitskin_sim.freeform.touches import pool_of

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
