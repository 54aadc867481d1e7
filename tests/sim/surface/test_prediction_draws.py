"""The prediction of every deformation that can be drawn passes what the runtime asks of one."""

import numpy as np
import pytest

from eitskin.reference.plausible import check_prediction
from eitskin_sim.scene.family import draw, paper_bends
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import flat_voltages, predict


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(3)
    clouds = [measured_cloud(bend, rng) for bend in (*paper_bends(3), *draw("A", 4, 31), *draw("B", 4, 31))]
    return [(cloud, predict(cloud)) for cloud in clouds]


def test_every_drawn_prediction_passes(drawn):
    for cloud, predicted in drawn:
        check_prediction(cloud, predicted, flat_voltages(), None)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda volts: 0.0 * volts, np.negative, np.abs, lambda volts: 1e-3 * volts, lambda volts: 1.8 * volts,
        lambda volts: 0.5 * volts, lambda volts: volts[::-1], lambda volts: np.roll(volts, 1), np.ones_like,
    ],
    ids=["zeros", "other sign", "without sign", "mV", "too large", "too small", "reversed", "one row on", "ones"],
)  # fmt: skip
def test_no_spoiled_prediction_passes(drawn, spoil):
    for cloud, predicted in drawn:
        with pytest.raises(ValueError, match="expected"):
            check_prediction(cloud, spoil(predicted), flat_voltages(), None)
