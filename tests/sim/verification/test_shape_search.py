"""Shapes that nothing scanned: found from frames, held for the next ones, and refused where a skin has no family."""

from dataclasses import replace
from functools import lru_cache
from itertools import count

import numpy as np
import pytest
from tests.sim.verification.frames import NOTHING, OTHER, SQUARE, Array, noisy, shares_of

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.parts import Deformations
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.freeform.sheet import assembled_metric
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import flat_metric_of, nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.shapes.sheet import TouchedSheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import flat_voltages, predict
from eitskin_sim.verification.metric_family import metric_family
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.shape_verifier import ShapeVerifier
from eitskin_sim.verification.sheet_model import model_without_scan

FINE_MM = 2.5
"""Elements of the data: the fit's are nearly twice as large."""

BEND = Bend(angle_deg=110.0, axis_deg=25.0, skew=0.3, twist_deg=-18.0, stretch_along=1.13, nonuniformity=0.08)

PIECES = np.array([[0, 40.0, 35.0, 10.0, 10.0, 0.0, 50.0, 0.0], [0, 85.0, 60.0, 12.0, 10.0, 0.0, 50.0, 0.0]])


@lru_cache(maxsize=2)
def sheet(bend: Bend) -> TouchedSheet:
    metric = flat_metric_of(PAPER) if bend == Bend() else bend_metric(bend, nominal_sheet(PAPER))
    return TouchedSheet(assembled_metric(metric, FINE_MM), shared_mesh(FINE_MM, None, PAPER))


def read(bend: Bend, pieces: Array, seed: int) -> Array:
    """Return (104,) V of a frame."""
    return noisy(sheet(bend).solve(pieces).voltages_V, seed)


def verifier(*, is_guess: bool = True) -> ShapeVerifier:
    """Return one that was given a flat cloud, whose time is counted in looks at the clock."""
    looks = count()
    own = ShapeVerifier(sheet(Bend()).untouched_V, Noise("N2", 50.0), clock=lambda: 1e-3 * next(looks))
    own.deform(flat_cloud(), is_guess=is_guess)
    return own


@pytest.mark.parametrize("pieces", [SQUARE, PIECES], ids=["one", "two"])
def test_touches_on_a_shape_that_nothing_scanned_are_found_within_their_errors(pieces: Array) -> None:
    own = verifier()
    found = own.verify(read(BEND, pieces, 3), shares_of(), 10.0)
    assert not found.flagged
    assert len(found.touches) == len(pieces)
    held = own.deformation.model
    for verdict in (found, own.verify(read(BEND, pieces, 4), shares_of(*pieces), 10.0)):
        for touch in verdict.touches:
            off = np.hypot(*(pieces[:, 1:3] - touch.centre_mm).T).min()
            assert off < min(4.0 * np.hypot(*touch.centre_error_mm), 1.5)
    assert own.deformation.model is held, "the shape serves the next frame"


def test_an_untouched_frame_tells_the_shape_for_the_touches_after_it() -> None:
    own = verifier()
    assert own.use_untouched(np.mean([read(BEND, NOTHING, seed) for seed in range(20)], axis=0), 20)
    known = own.deformation.model
    beside = np.log(np.abs(known.touched.untouched_V / sheet(BEND).untouched_V))
    assert np.ptp(beside) < 0.01, "a common factor may be drift as well"
    found = own.verify(read(BEND, SQUARE, 3), shares_of(SQUARE), 10.0)
    assert not found.flagged
    assert found.pieces[0, 1:3] == pytest.approx(SQUARE[0, 1:3], abs=1.0)
    assert own.deformation.model is known


def test_the_cloud_of_a_shape_that_was_found_predicts_what_the_scan_does() -> None:
    """Up to a common factor, which may be drift as well; V_pred of the flat cloud is off by 25 % rms."""
    scanned = predict(measured_cloud(BEND))
    assert np.std(np.log(np.abs(flat_voltages() / scanned))) > 0.2
    touched, rested = verifier(), verifier()
    assert not touched.verify(read(BEND, SQUARE, 3), shares_of(SQUARE), 10.0).flagged
    assert rested.use_untouched(np.mean([read(BEND, NOTHING, seed) for seed in range(20)], axis=0), 20)
    for own in (touched, rested):
        cloud = own.another_cloud()
        assert cloud is not None
        assert own.another_cloud() is None, "it is as before"
        assert np.std(np.log(np.abs(predict(cloud) / scanned))) < 0.025


def test_a_flat_sheet_is_explained_as_with_the_flat_cloud() -> None:
    frame, shares = read(Bend(), SQUARE, 3), shares_of(SQUARE)
    guessed, told = (verifier(is_guess=guess).verify(frame, shares, 10.0) for guess in (True, False))
    assert np.array_equal(guessed.pieces, told.pieces)
    assert guessed.p_value == told.p_value


@pytest.mark.parametrize("bend", [Bend(), BEND], ids=["flat", "bent"])
def test_drift_that_the_network_takes_for_a_touch_is_none(bend: Bend) -> None:
    drift = np.array([[0, 37.5, 50.0, 70.0, 90.0, 0.0, 0.96, 0.0]])
    found = verifier().verify(0.95 * read(bend, drift, 3), shares_of(OTHER), 10.0)
    assert (found.flagged, found.touches) == (False, ())


def test_a_frame_of_no_shape_is_flagged_and_has_no_cloud() -> None:
    own, odd = verifier(), read(BEND, SQUARE, 3) * (1.0 + 0.03 * (-1.0) ** np.arange(104))
    assert own.verify(odd, shares_of(SQUARE), 10.0).flagged
    assert own.another_cloud() is None


def test_modes_answer_as_sheets_with_them_do() -> None:
    """A quotient of two models; within 4 %, since columns leave the contacts as they are."""
    model, family, step = model_without_scan(), metric_family(), 1e-2
    for mode in (0, 3, 9):
        amplitudes = np.zeros(len(model.held))
        amplitudes[mode] = step
        other = model.about(amplitudes)
        assert other is not None
        change = (other.touched.untouched_V - model.touched.untouched_V) / step
        column = model.unseen.columns[:, mode]
        assert np.linalg.norm(change - column) < 0.04 * np.linalg.norm(change)
    E, F, G = family.metric(np.full(family.stretch.shape[1], 2.0))(np.array([[75.0, 50.0], [0.0, 0.0]])).T
    assert (E * G - F**2 > 0.0).all(), "every amplitude is a metric"


def test_a_skin_without_deformations_is_refused() -> None:
    none = Deformations(*((0.0, 0.0),) * 4, (1.0, 1.0), (1.0, 1.0), (0.0, 0.0))
    with pytest.raises(ValueError, match=r"\[deformations\] are all fixed"):
        metric_family(replace(PAPER, deformations=none))
