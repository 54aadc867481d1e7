"""In which ways a surface is unlike a skin's deformations, and its curvature, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.familiar_shape import largest_curvature, unlike_family
from eitskin_proto.skin.parts import Deformations
from eitskin_proto.skin.skin import PAPER


def rolled(angle_deg, along=1.0, across=1.0):
    """Return a sheet rolled about y, its front inside for a positive angle."""
    x, y, _ = flat_cloud()
    curvature = np.deg2rad(angle_deg) / (150.0 * along)
    turned = curvature * along * (x - 75.0)
    return np.stack([np.sin(turned) / curvature, across * y, (1.0 - np.cos(turned)) / curvature])


def dented(height_mm, sigma_mm=12.0):
    x, y, _ = flat_cloud()
    return np.stack([x, y, height_mm * np.exp(-((x - 60.0) ** 2 + (y - 45.0) ** 2) / (2.0 * sigma_mm**2))])


def noisy(cloud):
    return cloud + 0.1 * np.random.default_rng(4).standard_normal(cloud.shape)


@pytest.mark.parametrize(
    ("cloud", "modes"),
    [
        (flat_cloud(), ()),
        (rolled(180.0, 1.22, 0.92), ()),
        (rolled(60.0, 1.5, 0.85), ("stretch",)),
        (rolled(20.0, 1.0, 1.2), ("stretch",)),
        (rolled(230.0), ("bend",)),
        (rolled(-60.0), ("bend",)),
        (dented(-10.0), ("dent",)),
        (dented(6.0, 15.0), ("dent",)),
    ],
)
def test_the_mode_that_is_off_is_named_through_a_scanners_noise(cloud, modes):
    assert unlike_family(noisy(cloud)) == modes


def test_a_skin_that_stretches_and_bends_further_has_wider_limits():
    wide = replace(PAPER, deformations=Deformations(stretch_along=(0.9, 1.6), angle_deg=(-90.0, 270.0)))
    for cloud in (rolled(60.0, 1.5), rolled(270.0), rolled(-90.0)):
        assert unlike_family(cloud, wide) == ()


def test_the_curvature_of_a_sphere_is_one_over_its_radius_squared():
    x, y, _ = flat_cloud()
    sphere = np.stack([x, y, 200.0 - np.sqrt(200.0**2 - (x - 75.0) ** 2 - (y - 50.0) ** 2)])
    assert largest_curvature(sphere, PAPER.grid) == pytest.approx(1.0 / 200.0**2, rel=0.1)
    assert largest_curvature(rolled(120.0), PAPER.grid) < 1e-9
