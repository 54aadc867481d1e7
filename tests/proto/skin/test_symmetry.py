"""The mirror group of a skin is computed from its electrodes."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.parts import Outline, Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.symmetry import NEAR_MM, images, near_images


def _with(arc):
    return replace(PAPER, electrodes=Ring(arc_length_mm=Quantity(tuple(float(one) for one in arc))))


def _place(arc, length, width):
    """Return the (16, 2) places of arc lengths on a rectangle, by walking round it."""
    corners = np.array([[0, 0], [length, 0], [length, width], [0, width], [0, 0]], dtype=float)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    return np.stack([np.interp(arc, along, corners[:, axis]) for axis in (0, 1)], axis=-1)


def test_the_paper_s_sheet_has_four_images_that_lie_on_one_another():
    found = images(PAPER)
    assert [(one.x, one.y) for one in found] == [(False, False), (True, False), (False, True), (True, True)]
    place = _place(PAPER.arc_length_mm, 150.0, 100.0)
    for one in found:
        mirrored = place * (-1.0 if one.x else 1.0, -1.0 if one.y else 1.0) + (150.0 * one.x, 100.0 * one.y)
        np.testing.assert_allclose(mirrored, place[list(one.electrodes)], atol=1e-9)
    assert found[1].electrodes[:5] == (4, 3, 2, 1, 0)
    assert found[2].electrodes[0] == 12


def test_a_ring_that_is_off_by_millimetres_is_nearly_symmetric_and_has_the_images_of_the_even_one():
    off_mm = np.random.default_rng(5).uniform(-0.4, 0.4, 16) * NEAR_MM
    skin = _with(PAPER.arc_length_mm + off_mm)
    assert len(images(skin)) == 1
    assert near_images(skin) == images(PAPER) == near_images(PAPER)
    far = PAPER.arc_length_mm.copy()
    far[5] += 1.1 * NEAR_MM
    assert len(near_images(_with(far))) == 1


@pytest.mark.parametrize(("first", "count"), [(0.0, 4), (0.5, 4), (0.2, 2)])
def test_a_disc_is_symmetric_where_its_ring_is(first, count):
    step = np.pi * 100.0 / 16
    disc = replace(
        PAPER,
        outline=Outline("disc", (100.0, 100.0)),
        electrodes=Ring(arc_length_mm=Quantity(tuple((first + np.arange(16)) * step))),
    )
    assert len(images(disc)) == count  # half a turn is left in any case
