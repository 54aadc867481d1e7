"""The study of twins: what is recorded of a drawn device, and what calibration makes of it."""

import numpy as np
import pytest

from eitskin_proto.sensor.table import ROW_IN_FULL
from eitskin_proto.skin.toml import named
from eitskin_sim.calibration.report import calibrate
from eitskin_sim.evaluation.device import draw_device
from eitskin_sim.evaluation.device_runs import voltages_of
from eitskin_sim.evaluation.mismatch import LAB

from .study import study

twins = study("twins")
FRAMES, STAMP_MM, recorded = twins.FRAMES, twins.STAMP_MM, twins.recorded

SNR_DB = 50.0


@pytest.mark.heavy
def test_a_recording_is_of_that_device_and_noisy_as_it_says():
    device = draw_device(LAB, 0, 1)
    found = recorded(device, 1, SNR_DB, 2, 2, "lower")
    again = recorded(device, 1, SNR_DB, 2, 2, "raise")
    true = voltages_of(device.reference(), device.front_end)
    off = found.reference_V[ROW_IN_FULL] / true - 1.0
    assert found.reference_V.shape == (208,)
    assert found.frames == FRAMES
    assert 1e-4 < np.std(off) < 1e-3  # noise of 3e-4, and another mesh
    for one in found.bents:
        assert one.cloud_mm.shape == (3, 30, 45)
        assert np.std(one.voltages_V / true - 1.0) > 0.02
    assert len({tuple(one.xy_mm) for one in found.presses}) == len(found.presses) == 2
    for lower, higher in zip(found.presses, again.presses, strict=True):
        assert lower.stamp_mm == (STAMP_MM,)
        assert np.median(lower.voltages_V / true) > 1.0 > np.median(higher.voltages_V / true)


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
