"""Bent moments and presses, on a coarse mesh: derivatives against solving again, and what is found of one device."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.sensor.table import N_ROWS, TABLE
from eitskin_proto.skin.parts import Layer, Touches
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.calibration import model, session, solved
from eitskin_sim.calibration.bends import BendError
from eitskin_sim.calibration.fit import CalibrationError
from eitskin_sim.calibration.printed import table, verdict
from eitskin_sim.calibration.recording import LaterReading, Recording
from eitskin_sim.calibration.report import calibrate
from eitskin_sim.devices.readings import responses_of
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.measurement.front_end import FrontEnd
from eitskin_sim.scene.parts import Bend, Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_sim.surface.measured_cloud import measured_cloud

pytestmark = pytest.mark.slow

GAUGE, CONTRAST, DIAMETER_MM, BORDER_MM = 0.8, 0.45, 18.0, 4.0
FRAMES = 100
STAMP_MM = (16.0,)
STATED = replace(
    PAPER,
    name="ours",
    layer=replace(Layer(), gauge_factor=Quantity(0.0, "normal", 1.0)),
    front_end=replace(PAPER.front_end, snr_db=(50.0, 50.0)),
    touches=Touches(kind="lower", border_mm=(0.0, 8.0)),
)
BEND = Bend(angle_deg=60.0, stretch_along=1.1, stretch_across=0.99)
PLACES = [(50.0, 40.0), (100.0, 55.0), (75.0, 70.0)]


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """A coarse mesh for the true device too: it is the method that is tested; drawn bends have a test of their own."""
    error = BendError(np.zeros(N_ROWS), 0.02**2 * np.eye(N_ROWS), -0.01)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solved, "ELEMENT_MM", 8.0)
        patch.setattr(model, "MODEL_ERROR", 2e-3)
        patch.setattr(session, "bend_error", lambda skin: error)
        yield


def read(rng, bend=None, touches=(), drift=0.0, contrast=None):
    sheet = Sheet(gauge_factor=GAUGE)
    scene = Scene(sheet, bend=bend or Bend(), touches=touches, element_size_mm=8.0)
    volts = FrontEnd().read(responses_of(factorise_scene(scene).differences()), TABLE)
    return volts * np.exp(drift) * (1.0 + 10**-2.5 / np.sqrt(FRAMES) * rng.standard_normal(N_ROWS))


def press(rng, xy, contrast=CONTRAST, at=None):
    disc = Disc(*(xy if at is None else at), DIAMETER_MM / 2.0)
    touch = Touch((disc,), contrast=contrast, border_mm=BORDER_MM)
    return LaterReading(read(rng, touches=(touch,), drift=0.005), FRAMES, None, np.array(xy), STAMP_MM)


@pytest.fixture(scope="module")
def recorded(coarse):
    rng = np.random.default_rng(5)
    cloud = measured_cloud(BEND).astype(np.float64)
    bent = LaterReading(read(rng, bend=BEND, drift=-0.005), FRAMES, cloud)
    return Recording(read(rng), FRAMES, (bent,), tuple(press(rng, xy) for xy in PLACES[:2]))


def test_derivatives_are_those_of_solving_again(recorded):
    found = session.Session(STATED, recorded, 50.0)
    z = 0.3 * np.random.default_rng(1).standard_normal(found.count)
    residuals, jacobian = found.linearised(z)
    assert np.allclose(residuals, found.residuals(z))
    for at in range(found.count):
        step = 0.02 * np.eye(found.count)[at]
        again = (found.residuals(z - step) - found.residuals(z + step)) / 0.04
        scale = np.sqrt(np.mean(again**2))
        assert np.sqrt(np.mean((jacobian[:, at] - again) ** 2)) < 0.05 * scale + 1e-3, at


@pytest.fixture(scope="module")
def calibrated(recorded):
    return calibrate(STATED, recorded, 50.0)


def test_gauge_factor_and_press_are_found_with_their_errors(calibrated):
    twin, report = calibrated
    gauge = report["parameters"]["gauge_factor"]
    assert abs(gauge["values"][0] - GAUGE) < 4.0 * gauge["standard_errors"][0]
    assert gauge["standard_errors"][0] < 0.3
    assert not gauge["unknown"]
    found = report["press"]
    assert abs(found["contrast"] - CONTRAST) < 4.0 * found["contrast_error"]
    assert found["contrast_error"] < 0.15
    assert abs(found["size_mm"][0] - DIAMETER_MM) < 4.0 * found["size_error_mm"]
    assert list(report["moments"]) == ["bent moment 0", "press 0 at (50, 40) mm", "press 1 at (100, 55) mm"]
    assert "A press: contrast 0.4" in verdict(report)
    low, high = twin.touches.lowering_contrast
    assert low < CONTRAST < high
    assert twin.layer.gauge_factor.value == pytest.approx(gauge["values"][0])


def test_the_layer_and_each_press_s_own_strength_and_place_are_shown_with_errors(calibrated):
    _, report = calibrated
    one, other = (report["moments"][name]["press"] for name in list(report["moments"])[1:])
    assert report["moments"]["bent moment 0"]["press"] is None
    assert one["strength"] == pytest.approx(1.0, abs=4.0 * one["strength_error"])
    assert np.all(np.abs(other["off_mm"]) < 4.0 * np.array(other["off_error_mm"]))
    lines = table(report).splitlines()
    (shown,) = (line for line in lines if line.startswith("press 0 at (50, 40) mm: misfit"))
    assert (
        f"log contrast {one['strength']:.2f} +- {one['strength_error']:.2f} times the stamp's, place off by (" in shown
    )
    uneven = {"values": [0.1, -0.5], "standard_errors": [0.2, 0.9], "prior_errors": [1.0, 1.0], "unit": ""}
    line = table({**report, "parameters": {"layer": uneven}}).splitlines()[1]
    assert line.split() == ["layer", "(2)", "-0.5", "to", "0.1", "0.9", "1"]


@pytest.mark.slow  # five CPU-seconds: three presses, which a wrong one keeps from settling
def test_a_press_that_contradicts_the_others_is_named(recorded):
    rng = np.random.default_rng(9)
    wrong = press(rng, PLACES[2], at=(30.0, 20.0))
    _, report = calibrate(STATED, replace(recorded, bents=(), presses=(*recorded.presses, wrong)), 50.0)
    assert not report["explained"]
    worst = max(report["unexplained"], key=lambda one: one["misfit"] / one["limit"])
    assert worst["name"] == "press 2 at (75, 70) mm"
    said = verdict(report)
    assert said.startswith("NOT explained: press 2 at (75, 70) mm: misfit")
    assert len(said.splitlines()) == 4


def test_presses_that_change_nothing_are_refused_instead_of_making_touches_that_nobody_feels(recorded):
    rng = np.random.default_rng(11)
    faint = tuple(press(rng, xy, contrast=0.995) for xy in PLACES[:2])
    with pytest.raises(
        CalibrationError, match=r"presses change the voltages no more than noise and a drift of 1%: .*press_V"
    ):
        calibrate(STATED, replace(recorded, bents=(), presses=faint), 50.0)


def test_a_bend_that_is_no_bend_of_this_sheet_is_named(recorded):
    (bent,) = recorded.bents
    rows = bent.voltages_V.copy()
    rows[20:26] *= 1.6
    _, report = calibrate(STATED, replace(recorded, bents=(replace(bent, voltages_V=rows),), presses=()), 50.0)
    assert "bent moment 0" in [one["name"] for one in report["unexplained"]]
