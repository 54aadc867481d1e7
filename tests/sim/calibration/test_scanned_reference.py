"""A reference with its scan: what is found of a sheet that was never flat, on a mesh of its own."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.sensor.table import FULL_TABLE, N_FULL_ROWS, N_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.skin.parts import Instrument, Layer, Ring, Touches
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.calibration import bends, model, session, solved, unseen
from eitskin_sim.calibration.bends import BendError, ScanError
from eitskin_sim.calibration.printed import table
from eitskin_sim.calibration.recording import LaterReading, Recording
from eitskin_sim.calibration.report import calibrate
from eitskin_sim.calibration.session import Session
from eitskin_sim.devices.readings import responses_of
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.measurement.front_end import FrontEnd
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_sim.surface.measured_cloud import measured_cloud

FRAMES, GAIN, SPREAD_MM = 100, 0.01, 1.0
CONTRAST, DIAMETER_MM, STAMP_MM = 0.45, 18.0, (16.0,)
STATED = replace(
    PAPER,
    name="ours",
    electrodes=Ring(arc_length_mm=Quantity(tuple(PAPER.arc_length_mm.tolist()), "normal", SPREAD_MM)),
    front_end=Instrument(gain=Quantity(1.0, "normal", GAIN), snr_db=(50.0, 50.0)),
    touches=Touches(kind="lower", border_mm=(0.0, 8.0)),
)
LYING = Bend(angle_deg=40.0, stretch_along=1.03, stretch_across=0.99, nonuniformity=0.012)
PLACES = [(50.0, 40.0), (100.0, 55.0)]


class Skin:
    """A device that nobody knows, on elements that no fit uses."""

    def __init__(self, seed, element_size_mm=2.3, gauge=0.0):
        self.rng, self.element_size_mm = np.random.default_rng(seed), element_size_mm
        self.places = PAPER.arc_length_mm + SPREAD_MM * np.clip(self.rng.standard_normal(16), -2.0, 2.0)
        self.gain = 1.0 + GAIN * self.rng.standard_normal(16)
        self.sheet = Sheet(gauge_factor=gauge)
        self.cloud = measured_cloud(LYING, self.rng).astype(np.float64)

    def read(self, bend=LYING, touches=(), drift=0.0):
        electrodes = Electrodes(arc_length_mm=tuple(self.places))
        scene = Scene(self.sheet, electrodes, bend=bend, touches=touches, element_size_mm=self.element_size_mm)
        front_end = FrontEnd(gain=tuple(self.gain))
        volts = front_end.read(responses_of(factorise_scene(scene).differences()), FULL_TABLE) * np.exp(drift)
        return volts * (1.0 + 10**-2.5 / np.sqrt(FRAMES) * self.rng.standard_normal(N_FULL_ROWS))

    def press(self, xy):
        touch = Touch((Disc(*xy, DIAMETER_MM / 2.0),), contrast=CONTRAST, border_mm=4.0)
        return LaterReading(self.read(touches=(touch,), drift=0.005)[ROW_IN_FULL], FRAMES, None, np.array(xy), STAMP_MM)


@pytest.fixture
def coarse(monkeypatch):
    """A coarse mesh, and a stated error of scans: for derivatives, which need no more."""
    root = 0.02 * np.eye(N_ROWS) + 0.01
    error = BendError(np.full(N_ROWS, 0.003), root @ root.T, -0.1)
    monkeypatch.setattr(solved, "ELEMENT_MM", 8.0)
    monkeypatch.setattr(model, "MODEL_ERROR", 2e-3)
    monkeypatch.setattr(unseen, "bend_error", lambda skin, like: error)
    monkeypatch.setattr(session, "bend_error", lambda skin: error)


@pytest.fixture
def coarser(monkeypatch):
    """A coarser mesh whose error is stated, and fewer drawn bends: for fits."""
    monkeypatch.setattr(solved, "ELEMENT_MM", 6.0)
    monkeypatch.setattr(model, "MODEL_ERROR", 2e-3)
    monkeypatch.setattr(bends, "DRAWS", 60)
    bends.bend_error.cache_clear()
    yield
    bends.bend_error.cache_clear()


def scores(found, truth):
    return (np.array(found["values"]) - truth) / np.array(found["standard_errors"])


def test_derivatives_are_those_of_solving_again(coarse):
    skin = Skin(1, 8.0)
    bend = Bend(angle_deg=60.0, stretch_along=1.1)
    bent = LaterReading(skin.read(bend)[ROW_IN_FULL], FRAMES, measured_cloud(bend).astype(np.float64))
    recording = Recording(skin.read(), FRAMES, (bent,), (skin.press(PLACES[0]),), skin.cloud)
    stated = replace(STATED, layer=replace(Layer(), gauge_factor=Quantity(0.3, "normal", 1.0)))
    found = Session(stated, recording)
    z = 0.3 * np.random.default_rng(1).standard_normal(found.count)
    residuals, jacobian = found.linearised(z)
    assert np.allclose(residuals, found.residuals(z))
    slices = found.flat.parameters.slices
    some = [slices[name].start for name in ("gain", "gauge_factor", unseen.UNSEEN)]
    for at in [*some, slices[unseen.UNSEEN].stop - 1]:
        step = 0.02 * np.eye(found.count)[at]
        again = (found.residuals(z - step) - found.residuals(z + step)) / 0.04
        scale = np.sqrt(np.mean(again**2))
        assert np.sqrt(np.mean((jacobian[:, at] - again) ** 2)) < 0.05 * scale + 1e-3, at


def test_what_no_scan_shows_moves_a_row_and_its_reciprocal_alike_and_no_press(coarse):
    skin = Skin(1, 8.0)
    recording = Recording(skin.read(), FRAMES, (), (skin.press(PLACES[0]),), skin.cloud)
    found = Session(STATED, recording)
    flat, lying = found.flat, found.moments[0].lying
    z = np.zeros(found.count)
    moved = z.copy()
    moved[flat.parameters.slices[unseen.UNSEEN]] = np.random.default_rng(2).standard_normal(N_ROWS)
    before, after = (flat.read(one, derivatives=False).voltages_V for one in (z, moved))
    factor = after / before
    assert np.ptp(factor) > 0.01
    assert np.allclose(factor[ROW_IN_FULL], factor[RECIPROCAL_IN_FULL])
    pressed = [flat.read(one, lying, derivatives=False).voltages_V for one in (z, moved)]
    assert np.allclose(pressed[0] / before, pressed[1] / after), "what is held against the reference is off alike"


@pytest.mark.slow  # twice six bends on the usual mesh
def test_a_model_of_a_scan_that_is_hardly_stretched_is_off_by_less():
    near = bends.drawn_errors(PAPER, 6, like=ScanError(0.03, 0.1))[0]
    assert np.sqrt(np.mean(near**2)) < 0.5 * np.sqrt(np.mean(bends.drawn_errors(PAPER, 6)[0] ** 2))


@pytest.mark.slow  # 60 bends that look like the scan, and fits
def test_electrodes_and_gain_of_a_sheet_that_never_lay_flat_are_within_their_errors(coarser):
    skin = Skin(4)
    full = skin.read()
    errors = {}
    for rows, volts in ((N_FULL_ROWS, full), (N_ROWS, full[ROW_IN_FULL])):
        twin, report = calibrate(STATED, Recording(volts, FRAMES, cloud_mm=skin.cloud))
        places, gain = report["parameters"]["arc_length_mm"], report["parameters"]["gain"]
        for one, truth in ((places, skin.places), (gain, skin.gain)):
            assert np.sum(scores(one, truth) ** 2) < 45.9  # chi-square of 16: 1 in 10,000
        assert np.mean(places["standard_errors"]) < 0.5 * SPREAD_MM
        assert report["misfit"] < report["misfit_limit"]
        assert report["reference_scan"]["unseen_rms"] < 2.0 * report["reference_scan"]["expected_rms"]
        assert unseen.UNSEEN not in report["parameters"]
        assert "scan of the reference: what it does not show changes rows by" in table(report)
        assert twin.grid_id == PAPER.grid_id
        errors[rows] = np.mean(gain["standard_errors"])
    assert errors[N_FULL_ROWS] < 0.5 * errors[N_ROWS], "reciprocity tells the front end whatever the scan leaves open"
    assert not calibrate(STATED, Recording(full, FRAMES))[1]["explained"], "as if it had lain flat"


@pytest.mark.slow  # the same
def test_the_scan_of_another_bend_does_not_explain_the_reference(coarser):
    skin = Skin(6)
    other = measured_cloud(Bend(angle_deg=20.0, stretch_along=0.95, stretch_across=1.08)).astype(np.float64)
    _, report = calibrate(STATED, Recording(skin.read(), FRAMES, cloud_mm=other))
    assert [one["name"] for one in report["unexplained"]] == ["reference"]
