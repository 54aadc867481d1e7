"""The verifier with its physics: units and shapes from letters, and the process that answers them."""

import dataclasses
import time

import numpy as np
import pytest

from eitskin.messaging.streams.verified import pack_head, unpack_verified
from eitskin_proto.sensor.row_gaussian import rows_of as rows_of_electrodes
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import to_toml
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import RECTANGLE
from eitskin_sim.verification.network_map import map_of
from eitskin_sim.verification.sheet_model import model_of_cloud, touched_sheet
from eitskin_tools.verifier.checkers import CannotVerifyError, Checker
from eitskin_tools.verifier.child import Placement, VerifierProcess
from eitskin_tools.verifier.letters import LARGEST_PACKET, STATE, BaselineLetter, FrameLetter, Setup, packed, unpack

pytestmark = [pytest.mark.slow, pytest.mark.heavy]

NOISE = 3e-3
TOUCHED = [33, 80]
"""Units."""

NOTHING = np.zeros(104, dtype=np.bool_)
PIECE = np.array([[0, 60.0, 45.0, 12.0, 10.0, 0.0, 50.0, 0.0]])
PATIENCE_S = 300.0


def setup_of(skin, labels, reference_V):
    lifted = skin.grid.flat_cloud_mm() + np.array([0.0, 0.0, 7.0])[:, None, None]
    spread_V = NOISE * np.abs(reference_V)
    return Setup(
        1, labels, "raise", to_toml(skin), lifted.astype("f4"), reference_V, spread_V, np.zeros((104, 0)), 60.0
    )


@pytest.fixture(scope="module")
def model():
    return model_of_cloud(PAPER.grid.flat_cloud_mm())


@pytest.fixture(scope="module")
def units(model):
    """Return a setup, and dV and the map of two touched units of which the network shows one beside its place."""
    boxes = np.array([PAPER.grid.unit_rect_mm(unit % 14, unit // 14) for unit in TOUCHED])
    pieces = np.zeros((2, 8))
    pieces[:, 0], pieces[:, 6] = RECTANGLE, 50.0
    pieces[:, 1:3], pieces[:, 3:5] = (boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]
    change = model.solve(pieces)[1]
    change += NOISE * (1.0 + change) * np.random.default_rng(2).standard_normal(104)
    shown = np.zeros(PAPER.grid.n_units)
    shown[[TOUCHED[0], TOUCHED[1] + 1]] = 1.0
    values = np.asarray(PAPER.grid.map_from_units(shown), dtype="f4").ravel()
    return setup_of(PAPER, "units", 1e-3 * model.flat_V), change.astype("f4"), values


def letter(change, values, missing=NOTHING, setup=1, fused=1):
    return FrameLetter(setup, 9, 1000, 5, 6, 4, fused, missing, change, values)


def test_units_that_a_network_shows_beside_their_place_are_found_and_placed_on_the_surface(units):
    setup, change, values = units
    checker = Checker(setup)
    for missing in (NOTHING, rows_of_electrodes((3,))):
        (chi_squared, degrees, p_value, flagged), touches, why = checker.check(
            letter(np.where(missing, 9.0, change).astype("f4"), values, missing)
        )
        assert [one.unit for one in touches] == TOUCHED
        assert (degrees, flagged, why) == (int((~missing).sum()) - 2, False, "")
        assert p_value > 1e-3
        assert chi_squared < 2.0 * degrees
        x0, y0, x1, y1 = PAPER.grid.unit_rect_mm(TOUCHED[0] % 14, TOUCHED[0] // 14)
        first = touches[0]
        assert (first.shape, first.centre_error_mm) == ("unit", None)
        assert first.centre_mm == pytest.approx(((x0 + x1) / 2, (y0 + y1) / 2))
        assert first.place_mm == pytest.approx((*first.centre_mm, 7.0), abs=1e-3)
        assert first.normal == pytest.approx((0.0, 0.0, 1.0), abs=1e-4)
        assert first.strength_mm2 == pytest.approx(first.area_mm2 * np.log(first.contrast))
    dense = np.asarray(PAPER.grid.map_from_units((np.arange(126) < 7).astype(float)), dtype="f4").ravel()
    with pytest.raises(CannotVerifyError, match="7 units are shown, and at most 6 are verified"):
        checker.check(letter(change, dense))


def test_shapes_are_found_with_their_errors_and_without_rows_that_are_missing(model):
    change = model.solve(PIECE)[1]
    change += NOISE * (1.0 + change) * np.random.default_rng(1).standard_normal(104)
    values = map_of(PIECE).astype("f4").ravel()
    checker = Checker(setup_of(PAPER, "area", 1e-3 * model.flat_V))
    for missing in (NOTHING, rows_of_electrodes((3,))):
        read = np.where(missing, 9.0, change).astype("f4")
        (_, degrees, p_value, flagged), (touch,), why = checker.check(letter(read, values, missing))
        assert (touch.shape, touch.unit, flagged, why) == ("rectangle", None, False, "")
        assert degrees < int((~missing).sum())
        assert touch.area_range_mm2[0] < touch.area_mm2 < touch.area_range_mm2[1]
        assert touch.contrast_range[0] < touch.contrast < touch.contrast_range[1]
        assert -1.0 <= touch.size_contrast_correlation <= 1.0
        assert touch.angle_error_rad is None
        assert touch.centre_mm == pytest.approx((60.0, 45.0), abs=1.0)
        assert touch.place_mm[2] == pytest.approx(7.0, abs=1e-3)
        assert 0.0 < max(touch.centre_error_mm) < 2.0
    nothing = np.zeros_like(change).astype("f4")
    (_, _, p_value, flagged), _, why = checker.check(letter(nothing, np.zeros_like(values)))
    assert (flagged, why) == (False, "")
    assert p_value > 1e-3


def test_a_sheet_seen_at_rest_is_known_and_one_that_is_not_its_scans_is_said(model):
    for labels in ("area", "units"):
        checker = Checker(setup_of(PAPER, labels, 1e-3 * model.flat_V))
        off = 0.05 * np.sin(np.arange(104.0))
        assert checker.learn_baseline(BaselineLetter(1, 50, np.full(104, 0.02))) == ""
        assert "send its cloud" in checker.learn_baseline(BaselineLetter(1, 50, off + 2.0 * np.abs(off)))


@pytest.mark.parametrize("kind", ["is_certain", "is_guess", "scan"])
def test_a_cloud_gives_way_to_the_shape_that_a_frame_shows_unless_it_is_certain(model, kind):
    bent = touched_sheet(bend_metric(Bend(twist_deg=20.0, stretch_along=1.12), nominal_sheet(PAPER)), PAPER)
    change = bent.solve(PIECE).voltages_V / model.flat_V - 1.0
    change += NOISE * (1.0 + change) * np.random.default_rng(2).standard_normal(104)
    image = map_of(PIECE).astype("f4").ravel()
    setup = dataclasses.replace(setup_of(PAPER, "area", 1e-3 * model.flat_V), budget_s=5.0)
    setup = dataclasses.replace(setup, **({} if kind == "scan" else {kind: True}))
    checker = Checker(setup)
    (*_, flagged), touches, why = checker.check(letter(change.astype("f4"), image))
    shown = checker.another_shape()
    assert (shown is not None) is (kind == "is_guess")
    if shown is not None:
        bends = np.log(np.abs(bent.untouched_V / model.flat_V))
        assert np.std(np.log(np.abs(shown[1] / shown[2])) - bends) < 0.03
    if kind == "is_certain":
        assert flagged
        return
    assert (flagged, why) == (False, "fitted")
    assert touches[0].centre_mm == pytest.approx(PIECE[0, 1:3], abs=1.0)


def test_a_cloud_that_no_model_can_have_gives_way_to_the_shape_of_frames(model):
    setup = setup_of(PAPER, "area", 1e-3 * model.flat_V)
    folded = setup.cloud_mm.copy()
    folded[0] = 75.0 - np.abs(folded[0] - 75.0)
    checker = Checker(dataclasses.replace(setup, cloud_mm=folded, budget_s=5.0))
    assert "the shape is fitted to frames: send another cloud" in checker.why
    change = model.touched.solve(PIECE).voltages_V / model.flat_V - 1.0
    (*_, flagged), touches, _ = checker.check(letter(change.astype("f4"), map_of(PIECE).astype("f4").ravel()))
    assert not flagged
    assert touches[0].centre_mm == pytest.approx(PIECE[0, 1:3], abs=1.0)
    with pytest.raises(ValueError, match="stiffness"):
        Checker(dataclasses.replace(setup, cloud_mm=folded, is_certain=True))


@pytest.mark.process
def test_the_process_refuses_what_is_no_skin_and_answers_frames_of_the_next(units):
    setup, change, values = units
    found = []
    with VerifierProcess(Placement()) as process:
        while process.line is None:
            time.sleep(0.01)
        process.line.send(packed(dataclasses.replace(setup, skin="no description")))

        def until(condition):
            end = time.monotonic() + PATIENCE_S
            while True:
                assert time.monotonic() < end, found
                time.sleep(0.01)
                try:
                    found.append(unpack(process.line.recv(LARGEST_PACKET)))
                except BlockingIOError:
                    continue
                if condition(found[-1]):
                    return found[-1]

        *_, why, _ = until(lambda one: one[:2] == [STATE, "failed"])
        assert why.startswith("not a TOML file")
        process.line.send(packed(dataclasses.replace(setup, number=2)))
        process.line.send(packed(letter(change, values, setup=2)))
        assert until(lambda one: one[:2] == [STATE, "ready"])[2] == 2
        _, told, flagged, spent_ms = until(lambda one: one[0] != STATE)
    assert flagged is False
    assert spent_ms > 0
    verdict = unpack_verified(pack_head(1, "run", {"checked": 1, "flagged": 0, "skipped": 0}) + told)
    assert (verdict.sequence, verdict.cloud, verdict.device_us) == (9, 4, 1000)
    assert [touch.unit for touch in verdict.touches] == TOUCHED
