"""Places and directions on surfaces that have a formula: rolled, moved rigidly, stretched, collapsed."""

import numpy as np
import pytest

from eitskin.touches.surface import Surface
from eitskin.touches.touch import LAYOUT, unpack_touches
from eitskin.touches.watch import TouchWatch

from .scripted import DX, GRID, square

FLAT = GRID.flat_cloud_mm()
RNG = np.random.default_rng(0)


def rolled(radius):
    """The sheet on a cylinder along y, its x = 75 mm on top: an isometry. Outwards is where the flat sheet faces."""
    angle = (FLAT[0] - 75.0) / radius
    return np.stack([radius * np.sin(angle), FLAT[1], radius * np.cos(angle)])


def touched(cloud, image):
    packed = TouchWatch(GRID).update(image.ravel(), 1, Surface(cloud, GRID), 0)
    (touch,) = unpack_touches(packed[0], LAYOUT.size, *packed[1:]).touches
    return touch


def test_the_flat_sheet_faces_z_up_to_its_border():
    x, y = RNG.uniform((0, 0), (150, 100), (200, 2)).T
    found = np.array(Surface(FLAT, GRID).at(x, y))
    assert found[:, :3] == pytest.approx(np.stack([x, y, 0 * x], axis=1), abs=1e-9)
    assert found[:, 3:] == pytest.approx(np.tile([0.0, 0.0, 1.0], (200, 1)), abs=1e-12)


@pytest.mark.parametrize("radius", [30.0, 60.0, 200.0])
def test_on_a_cylinder_place_and_direction_are_the_formulas(radius):
    x, y = RNG.uniform((DX, DX), (150 - DX, 100 - DX), (200, 2)).T
    found = np.array(Surface(rolled(radius), GRID).at(x, y))
    angle = (x - 75.0) / radius
    faces = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    place = radius * faces
    place[:, 1] = y
    sag = DX**2 / 8 / radius  # of a chord between two points
    assert np.abs(found[:, :3] - place).max() <= 1.1 * sag + 1e-9
    assert np.abs(found[:, 3:] - faces).max() <= (DX / radius) ** 2
    border = np.array(Surface(rolled(radius), GRID).at([0.0, 150.0], [50.0, 50.0]))
    ends = np.array([-75.0, 75.0]) / radius
    assert np.abs(border[:, 3] - np.sin(ends)).max() <= 0.6 * DX / radius  # straight on, half a pixel


def test_a_collapsed_surface_has_no_direction_and_no_area_and_nothing_is_not_a_number():
    line = FLAT.copy()
    line[1:] = 0.0
    for cloud in (np.zeros_like(FLAT), line):
        touch = touched(cloud, square(50.0, 50.0))
        assert touch.normal == (0.0, 0.0, 0.0)
        assert touch.surface_mm2 == 0.0
        assert np.isfinite(touch.place_mm).all()
    folded = FLAT.copy()
    folded[:, :, 20] = folded[:, :, 19] = folded[:, :, 18]
    found = np.array(Surface(folded, GRID).at(*RNG.uniform((50, 20), (80, 80), (100, 2)).T))
    assert np.isfinite(found).all()
    assert np.abs(np.linalg.norm(found[:, 3:], axis=1) - 1.0).max() < 1e-9  # its neighbours say where it faces
