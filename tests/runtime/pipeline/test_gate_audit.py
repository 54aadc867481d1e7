"""The gate is looked after: a strong map overrules a gate that sees nothing."""

import numpy as np
import pytest

from eitskin.errors import BundleError
from eitskin.pipeline.frame_pipeline import AUDIT_FRAMES, WITHOUT_ROWS, GateAudit, Pipeline, audit_pixels
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


def test_a_look_at_an_untouched_sheet_changes_nothing_but_what_was_skipped(pipeline, counts):
    pipeline.engines[0], pipeline.audit = Sees(pipeline.buffers), GateAudit(9, 1350)
    solvers, skipped = set(), []
    for sequence in range(1, 2 * AUDIT_FRAMES + 1):
        assert go(pipeline, payload(counts, sequence))
        solvers.add(pipeline.record.solver)
        skipped.append(pipeline.record.skipped[0])
    assert solvers == {"none"}
    assert skipped.count("map:untouched") == 2
    assert skipped.count("inference:untouched") == 2 * AUDIT_FRAMES - 2


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


def test_frames_that_nobody_wants_are_not_looked_at(pipeline, counts):
    pipeline.audit = GateAudit(9, 1350)
    for sequence in range(1, 2 * AUDIT_FRAMES):
        assert go(pipeline, payload(counts, sequence), wanted=False)
        assert not pipeline.record.inferred


def test_a_bundle_that_does_not_say_what_is_strong_is_not_looked_after(pipeline, counts):
    for sequence in range(1, 2 * AUDIT_FRAMES):
        assert go(pipeline, payload(counts, sequence))
        assert not pipeline.record.inferred


@pytest.mark.parametrize("value", [0, 1351, 2.5, [3, 4], "many"])
def test_a_nonsensical_number_of_strong_pixels_is_refused(value):
    with pytest.raises(BundleError, match=r"audit_pixels is .*, expected one whole number from 1 to 1350"):
        audit_pixels({"audit_pixels": np.array(value)}, 1350)
    assert audit_pixels({"audit_pixels": np.array(12, np.uint16)}, 1350) == 12
    assert audit_pixels(None, 1350) is None


def test_only_a_network_may_overrule_the_gate(tiny, hello, touched, counts):
    pipeline = Pipeline(tiny, hello, solver="tikhonov")
    pipeline.use_reference(Reference(counts * 1e-9, counts * 0.0, 2, "TEST-1", 0xABCD, "paper", ""))
    pipeline.gate, pipeline.audit = Blind(), GateAudit(9, 1350)
    for sequence in range(1, 2 * AUDIT_FRAMES):
        assert go(pipeline, payload(touched, sequence))
        assert pipeline.record.solver == "none"
