"""The cloud of a known bend: what a scanner can know of it, and no more."""

import numpy as np
import pytest

from eitskin_proto.skin.cloud import align_cloud, flat_cloud
from eitskin_sim.scene.parts import Bend
from eitskin_sim.surface.measured_cloud import NOISE_MM, measured_cloud


def test_the_flat_sheet_is_the_flat_cloud() -> None:
    assert measured_cloud(Bend()) == pytest.approx(flat_cloud(), abs=1e-4)


def test_a_bent_cloud_keeps_its_arc_length() -> None:
    cloud = measured_cloud(Bend(angle_deg=120.0, stretch_along=1.1)).astype(float)
    steps = np.linalg.norm(np.diff(cloud, axis=2), axis=0)
    pitch = 150.0 * 1.1 / 45
    chord = 2 * np.sin(np.deg2rad(120.0) / 45 / 2) / (np.deg2rad(120.0) / 45)
    assert steps == pytest.approx(pitch * chord, rel=1e-3)


def test_an_uneven_stretch_leaves_no_trace() -> None:
    even, uneven = (measured_cloud(Bend(angle_deg=60.0, nonuniformity=a)) for a in (0.0, 0.1))
    assert np.abs(even - uneven).max() < 0.05


def test_noise_is_a_tenth_of_a_millimetre_in_the_agreed_pose() -> None:
    bend = Bend(angle_deg=90.0, twist_deg=20.0)
    noisy = measured_cloud(bend, np.random.default_rng(0))
    error = noisy - measured_cloud(bend)
    assert error.std() == pytest.approx(NOISE_MM, rel=0.05)
    assert noisy == pytest.approx(align_cloud(noisy), abs=1e-4)
    assert noisy.dtype == np.float32
