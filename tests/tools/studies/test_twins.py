"""The study of twins: what is recorded of a drawn device, and what calibration makes of it."""

import numpy as np
import pytest

from eitskin_proto.skin.toml import named
from eitskin_sim.calibration.report import calibrate
from eitskin_sim.evaluation.device import draw_device
from eitskin_sim.evaluation.mismatch import LAB

from .study import study

twins = study("twins")
FRAMES, STAMP_MM, recorded = twins.FRAMES, twins.STAMP_MM, twins.recorded

SNR_DB = 50.0


@pytest.mark.slow
@pytest.mark.parametrize(("way", "contrasts"), [("lower", (0.4, 0.6)), ("raise", (5.0, 20.0))])
def test_calibration_finds_the_gauge_factor_and_what_presses_are_like(way, contrasts):
    device = draw_device(LAB, 0, 0)
    twin, said = calibrate(named("lab"), recorded(device, 0, SNR_DB, 3, 6, way), SNR_DB)
    gauge = twin.layer.gauge_factor
    assert abs(gauge.value - LAB.gauge_factor) < 3.0 * gauge.spread
    assert gauge.spread < 0.5 * named("lab").layer.gauge_factor.spread
    strength = said["parameters"]["press_log_contrast"]["values"][0]
    low, high = np.sort(np.abs(np.log(contrasts)))
    assert low < strength < high
    assert twin.touch_kind == way
    touches = twin.touches
    ends = np.abs(np.log(touches.lowering_contrast if way == "lower" else touches.raising_contrast))
    wide = ends.max() / ends.min()
    assert wide == pytest.approx(4.0, rel=1e-3) if way == "lower" else 1.5 < wide < 3.5  # half to twice; its errors
