"""The map between square and disc: conformal, there and back, corners and sides where they belong."""

import numpy as np
import pytest

from eitskin_sim.tank.disc_map import DiscMap

SIDE_MM = 100.0


def inside(count=300):
    return np.random.default_rng(0).uniform(1.0, SIDE_MM - 1.0, (count, 2))


def test_the_map_is_conformal_and_its_scale_is_its_slope():
    disc, at, h = DiscMap(SIDE_MM, 30.0), inside(), 1e-4
    along_x, along_y = ((disc.to_disc(at + h * e) - disc.to_disc(at - h * e)) / (2 * h) for e in np.eye(2))
    turned = np.stack([-along_x[:, 1], along_x[:, 0]], axis=-1)
    assert np.allclose(along_y, turned, atol=1e-7)  # Cauchy and Riemann
    assert np.allclose(np.hypot(*along_x.T), disc.scale(at), atol=1e-8)


def test_points_within_the_square_lie_within_the_disc():
    assert np.hypot(*DiscMap(SIDE_MM, 30.0).to_disc(inside()).T).max() < 30.0


def test_the_border_is_the_rim_and_its_angles_come_back():
    disc, side = DiscMap(SIDE_MM, 30.0), SIDE_MM
    perimeter = 4 * side
    arc = np.linspace(0.0, perimeter, 200, endpoint=False) + 0.013
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side], [0, 0]], dtype=float)
    at = np.stack([np.interp(arc, side * np.arange(5), c) for c in corners.T], 1)
    rim = disc.to_disc(at)
    assert np.allclose(np.hypot(*rim.T), 30.0)
    angle = np.rad2deg(np.arctan2(rim[:, 1], rim[:, 0]))
    assert np.allclose(np.diff(np.unwrap(angle, period=360.0)) > 0.0, True)  # counter-clockwise
    assert np.allclose(disc.rim_to_arc_mm(angle), arc, atol=1e-6)
    assert np.allclose(disc.rim_to_arc_mm(angle + 720.0), arc, atol=1e-6)


def test_areas_add_up_to_the_disc():
    disc = DiscMap(SIDE_MM, 30.0)
    points, weights = np.polynomial.legendre.leggauss(60)
    x, y = np.meshgrid(*(2 * [(points + 1) * SIDE_MM / 2]))
    area = np.outer(weights, weights).ravel() * disc.scale(np.stack([x.ravel(), y.ravel()], -1)) ** 2
    assert area.sum() * SIDE_MM**2 / 4 == pytest.approx(np.pi * 30.0**2, rel=1e-3)
