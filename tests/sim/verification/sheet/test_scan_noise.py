"""A scan says itself how noisy it is."""

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.family import draw
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.verification.sheet.scan_noise import MOST_MM, scan_noise_mm


@pytest.mark.parametrize("noise_mm", [0.0, 0.1, 0.3, 1.0])
def test_the_noise_of_a_scan_is_seen_in_it(noise_mm: float) -> None:
    for number, bend in enumerate(draw("A", 3, 91, PAPER)):
        cloud = measured_cloud(bend, np.random.default_rng(number), noise_mm)
        found = scan_noise_mm(cloud, fit_cloud(cloud))
        assert found == pytest.approx(noise_mm, rel=0.06, abs=0.02)


def test_no_more_is_believed_than_a_scan_can_be_off() -> None:
    cloud = 50.0 * np.random.default_rng(0).standard_normal((3, *PAPER.grid.shape))
    assert scan_noise_mm(cloud, fit_cloud(cloud)) == MOST_MM
