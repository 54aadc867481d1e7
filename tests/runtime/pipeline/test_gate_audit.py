"""The gate is looked after: a strong map overrules a gate that sees nothing."""

import numpy as np
import pytest

from eitskin.pipeline.frame_pipeline import AUDIT_FRAMES, WITHOUT_ROWS, GateAudit

from .passing import go, payload


class Blind:
    """A gate that sees nothing."""

    logit = -9.0

    def touched(self):
        return False


class Sees:
    """A network that shows a touch everywhere as soon as any voltage has changed."""

    name = "vd2t"

    def __init__(self, buffers):
        self.buffers = buffers

    def infer(self):
        self.buffers.map[:] = np.abs(self.buffers.change).max() > 0.01


def test_a_gate_that_is_blind_is_overruled_by_a_strong_map_and_says_so(pipeline, counts, touched):
    pipeline.gate, pipeline.engines[0], pipeline.audit = Blind(), Sees(pipeline.buffers), GateAudit(9, 1350)
    for sequence in range(1, AUDIT_FRAMES):
        assert go(pipeline, payload(touched, sequence))
        assert pipeline.record.solver == "none"
    for sequence in range(AUDIT_FRAMES, AUDIT_FRAMES + 3):  # and from then on every frame
        assert go(pipeline, payload(touched, sequence))
        assert (pipeline.record.touched, pipeline.record.solver, pipeline.record.events) == (
            True,
            "vd2t",
            ("gate_overruled",),
        )
        assert not pipeline.record.map_is_zero
    assert pipeline.audit.overruled == 3
    assert go(pipeline, payload(counts, AUDIT_FRAMES + 3))  # the touch is over: one more look, then the gate alone
    assert (pipeline.record.touched, pipeline.record.solver, pipeline.record.skipped[0]) == (
        False,
        "none",
        "map:untouched",
    )
    assert go(pipeline, payload(counts, AUDIT_FRAMES + 4))
    assert pipeline.record.skipped[0] == "inference:untouched"


class Looks(GateAudit):
    """Looks at every frame that the gate calls untouched."""

    def looks(self, rows):
        return True


@pytest.mark.parametrize(("lacks_rows", "each"), [(True, WITHOUT_ROWS), (False, AUDIT_FRAMES)])
def test_while_rows_are_missing_frames_are_looked_at_more_often(lacks_rows, each):
    audit = GateAudit(9, 1350)
    due = [audit.is_due(lacks_rows=lacks_rows) for _ in range(3 * each)]
    assert due == [n % each == each - 1 for n in range(3 * each)]
    assert not any(GateAudit(None, 1350).is_due(lacks_rows=lacks_rows) for _ in range(3 * each))
