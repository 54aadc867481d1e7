import numpy as np
import pytest

from eitskin.model.gate import Gate
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.jacobian import flat_jacobian
from eitskin_sim.surface.predict import flat_voltages
from eitskin_training.gate.physical import FALSE_ALARM_RATE, Untouched, physical_gate, touch_logs


def test_a_gate_of_physics_tells_touches_from_bends_and_drift_that_it_never_saw() -> None:
    rng = np.random.default_rng(4)
    jacobian, reference = flat_jacobian(PAPER), flat_voltages(PAPER)
    directions = rng.normal(size=(12, N_ROWS)) * 0.3 ** np.arange(12)[:, None]
    learn, choose, measure = (0.3 * rng.normal(size=(count, 12)) @ directions for count in (400, 400, 400))
    touches, sizes_mm = touch_logs(jacobian, PAPER, np.ones(PAPER.grid.n_pixels, dtype=bool), rng, 600)
    assert touches.mean() < 0  # they raise conductance, so voltages fall
    arrays, facts = physical_gate(Untouched(learn, choose, measure), touches, sizes_mm, reference, PAPER, rng)
    gate = Gate(arrays)

    def rate(logs: np.ndarray) -> float:
        volts = reference * np.exp(logs + rng.normal(0, 0.05, (len(logs), 1)))  # as much drift as there may be
        noisy = volts * (1 + 10**-2.5 * rng.standard_normal(volts.shape))
        return float((gate.logits(relative_change(noisy, reference)) > gate.threshold).mean())

    assert rate(np.repeat(measure, 10, axis=0)) <= 2 * FALSE_ALARM_RATE
    assert facts["false_alarm_rate"] <= 2 * FALSE_ALARM_RATE
    assert rate(measure + touches[:400]) > 0.9
    assert facts["missed_rate"] < 0.1
    assert 5.0 <= facts["felt_mm"] < 15.0
    _, faint = physical_gate(Untouched(learn, choose, measure), 0.03 * touches, sizes_mm, reference, PAPER, rng)
    assert faint["felt_mm"] > 1.5 * facts["felt_mm"]
    with pytest.raises(ValueError, match="no touch changes rows"):
        physical_gate(Untouched(learn, choose, measure), 1e-4 * touches, sizes_mm, reference, PAPER, rng)
