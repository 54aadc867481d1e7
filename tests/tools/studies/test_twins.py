"""The study of twins: what is recorded of a drawn device, and what calibration makes of it."""

import numpy as np
import pytest

from eitskin_proto.skin.toml import named
from eitskin_sim.calibration import bends, model, solved
from eitskin_sim.calibration.report import calibrate
from eitskin_sim.evaluation.device import draw_device
from eitskin_sim.evaluation.mismatch import LAB

from .study import study

recorded = study("twins").recorded
SNR_DB = 50.0


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """A coarse mesh whose error is stated, and fewer drawn bends."""
    monkeypatch.setattr(solved, "ELEMENT_MM", 6.0)
    monkeypatch.setattr(model, "MODEL_ERROR", 2e-3)
    monkeypatch.setattr(bends, "DRAWS", 60)
    bends.bend_error.cache_clear()
    yield
    bends.bend_error.cache_clear()


@pytest.mark.slow
def test_calibration_finds_the_gauge_factor_and_what_presses_are_like():
    """Of presses that lower conductance: elements of 6 mm do not tell a raising contrast of 10 from a wide border."""
    device = draw_device(LAB, 0, 0)
    twin, said = calibrate(named("lab"), recorded(device, 0, SNR_DB, 2, 3, "lower"), SNR_DB)
    gauge = twin.layer.gauge_factor
    assert abs(gauge.value - LAB.gauge_factor) < 3.0 * gauge.spread
    assert gauge.spread < 0.5 * named("lab").layer.gauge_factor.spread
    strength = said["parameters"]["press_log_contrast"]["values"][0]
    assert -np.log(0.6) < strength < -np.log(0.4)
    assert twin.touch_kind == "lower"
    ends = np.log(twin.touches.lowering_contrast)
    assert ends.min() / ends.max() == pytest.approx(4.0, rel=1e-3)  # half to twice
