"""The gate is looked after: a strong map overrules a gate that sees nothing."""

import numpy as np
import pytest

from eitskin.pipeline.frame_pipeline import AUDIT_FRAMES, WITHOUT_ROWS, GateAudit, Pipeline
from eitskin.reference.captured import Reference

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


def test_no_frame_has_the_map_of_one_that_was_looked_at_and_went_out_as_untouched(tiny, hello, touched, counts):
    pipeline = Pipeline(tiny, hello, skip_unchanged=True)
    pipeline.use_reference(Reference(counts * 1e-9, np.abs(counts) * 1e-11, 100, "TEST-1", 0xABCD, "paper", ""))
    engine, gate = Sees(pipeline.buffers), Blind()
    engine.name = pipeline.engines[0].name
    pipeline.gate, pipeline.engines[0], pipeline.audit = gate, engine, Looks(1351, 1350)
    published, rng = {}, np.random.default_rng(0)
    for sequence in range(1, AUDIT_FRAMES + 4):
        gate.touched = lambda sees=sequence % AUDIT_FRAMES != 0: sees
        assert go(pipeline, payload(touched + rng.integers(-9, 9, 104), sequence))
        record = pipeline.record
        shown = 0.0 if record.map_is_zero else float(pipeline.buffers.map.max())
        assert published.setdefault(record.map_sequence, shown) == shown
    assert set(published.values()) == {0.0, 1.0}


class Sheet:
    """Knows whether rows are missing."""

    def __init__(self, lacks_rows):
        self.lacks_rows = lacks_rows


@pytest.mark.parametrize(("sheet", "each"), [(Sheet(True), WITHOUT_ROWS), (Sheet(False), AUDIT_FRAMES)])
def test_while_rows_are_missing_frames_are_looked_at_more_often(sheet, each):
    audit = GateAudit(9, 1350)
    assert [audit.is_due(sheet) for _ in range(3 * each)] == [n % each == each - 1 for n in range(3 * each)]
    assert not any(GateAudit(None, 1350).is_due(sheet) for _ in range(3 * each))


def test_only_a_network_may_overrule_the_gate(tiny, hello, touched, counts):
    pipeline = Pipeline(tiny, hello, solver="tikhonov")
    pipeline.use_reference(Reference(counts * 1e-9, counts * 0.0, 2, "TEST-1", 0xABCD, "paper", ""))
    pipeline.gate, pipeline.audit = Blind(), GateAudit(9, 1350)
    for sequence in range(1, 2 * AUDIT_FRAMES):
        assert go(pipeline, payload(touched, sequence))
        assert pipeline.record.solver == "none"
