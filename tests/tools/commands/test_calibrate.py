"""``eitskin calibrate`` on a device that is known: electrodes and instrument are found, and a misfit is reported."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.sensor.table import FULL_TABLE, ROW_IN_FULL
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.cloud_file import Surface, save_surface
from eitskin_proto.skin.parts import Instrument, Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import load, to_toml
from eitskin_sim.calibration import model, solved
from eitskin_sim.devices.device import Device
from eitskin_sim.devices.readings import responses_of
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.measurement.front_end import FrontEnd
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import Electrodes, Scene
from eitskin_tools.cli import main

SPREAD_MM = 1.0
GAIN = 0.01
STATED = replace(
    PAPER,
    name="ours",
    electrodes=Ring(arc_length_mm=Quantity(tuple(PAPER.arc_length_mm.tolist()), "normal", SPREAD_MM)),
    front_end=Instrument(gain=Quantity(1.0, "normal", GAIN), snr_db=(50.0, 50.0)),
)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """A coarse mesh for the true device too: it is the method that is tested, not the mesh."""
    monkeypatch.setattr(solved, "ELEMENT_MM", 8.0)
    monkeypatch.setattr(model, "MODEL_ERROR", 2e-3)


@pytest.fixture
def device():
    rng = np.random.default_rng(11)
    places = PAPER.arc_length_mm + SPREAD_MM * np.clip(rng.standard_normal(16), -2.0, 2.0)
    gain = 1.0 + GAIN * rng.standard_normal(16)
    return Device(electrodes=Electrodes(arc_length_mm=tuple(places)), front_end=FrontEnd(gain=tuple(gain)))


@pytest.fixture
def recorded(device, tmp_path):
    scene = Scene(device.sheet, device.electrodes, element_size_mm=8.0)
    volts = device.front_end.read(responses_of(factorise_scene(scene).differences()), FULL_TABLE)
    noisy = volts * (1.0 + 10 ** (-50.0 / 20.0) / 10.0 * np.random.default_rng(12).standard_normal(208))
    (tmp_path / "ours.toml").write_text(to_toml(STATED))
    np.savez(tmp_path / "r.npz", reference_V=noisy, reference_frames=np.array(100))
    return tmp_path


def test_what_is_off_is_found_and_written(recorded, device, capsys):
    out = recorded / "calibrated.toml"
    words = ["calibrate", str(recorded / "r.npz"), "--skin", str(recorded / "ours.toml"), "--out", str(out)]
    assert main([*words, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    places, gain = report["parameters"]["arc_length_mm"], report["parameters"]["gain"]
    for one, truth in ((places, device.electrodes.arc_length_mm), (gain, device.front_end.gain)):
        scores = (np.array(one["values"]) - truth) / np.array(one["standard_errors"])
        assert np.sum(scores**2) < 45.9  # chi-square of 16: 1 in 10,000
        assert np.abs(scores).max() < 4.0
    assert np.max(places["standard_errors"]) < 0.5 * SPREAD_MM
    assert report["misfit"] < report["misfit_limit"]
    assert report["unknown"] == []
    found = load(out)
    assert (found.calibrated_from, found.digest) == (STATED.digest, report["skin_digest"])
    assert found.grid_id == STATED.grid_id, "it is the same sheet, known better"
    assert np.allclose(found.arc_length_mm, places["values"], rtol=1e-5)
    error = np.sqrt(np.mean(np.square(places["standard_errors"])))
    assert found.electrodes.arc_length_mm.spread == pytest.approx(error, rel=1e-4)


def test_a_row_that_is_off_is_named_and_the_best_sheet_is_written(recorded, capsys):
    with np.load(recorded / "r.npz") as file:
        volts = file["reference_V"].copy()
    volts[7] *= 1.2
    np.savez(recorded / "r.npz", reference_V=volts, reference_frames=np.array(100))
    out = recorded / "calibrated.toml"
    words = ["calibrate", str(recorded / "r.npz"), "--skin", str(recorded / "ours.toml"), "--out", str(out)]
    assert main(words) == 0
    drive, measure = FULL_TABLE[7]
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("NOT explained: reference: misfit")
    assert f"worst, in units of noise: drive {drive} measure {measure} by " in said[0]
    assert "eitskin teach presses.npz --port PORT" in said[4], "the fifth line is the way on"
    assert said[5] == "", "the table follows"
    assert load(out).calibrated_from == STATED.digest


@pytest.mark.slow
def test_an_offset_larger_than_most_rows_is_found(recorded, device):
    with np.load(recorded / "r.npz") as file:
        volts = file["reference_V"].copy()
    offset_V = 0.0082 * 5.0 * np.mean(volts)
    np.savez(recorded / "r.npz", reference_V=0.0082 * volts + offset_V, reference_frames=np.array(100))
    out = recorded / "calibrated.toml"
    words = ["calibrate", str(recorded / "r.npz"), "--skin", str(recorded / "ours.toml"), "--out", str(out)]
    assert main(words) == 0
    found = load(out)
    assert np.allclose(np.array(found.front_end.offset_V.value) * 0.0082, offset_V, rtol=0.01)
    assert np.allclose(found.arc_length_mm, device.electrodes.arc_length_mm, atol=1.0)


@pytest.mark.slow
def test_rows_of_no_sheet_end_in_time_with_electrodes_on_the_border(recorded, capsys):
    with np.load(recorded / "r.npz") as file:
        volts = np.random.default_rng(1).permutation(file["reference_V"][ROW_IN_FULL])
    np.savez(recorded / "r.npz", reference_V=volts)
    out = recorded / "calibrated.toml"
    words = ["calibrate", str(recorded / "r.npz"), "--skin", str(recorded / "ours.toml"), "--out", str(out), "--json"]
    assert main(words) == 0
    report = json.loads(capsys.readouterr().out)
    assert not report["explained"]
    assert len(report["far"]) > 50
    place(nominal_sheet(load(out)), nominal_electrodes(load(out)))


def test_a_scan_that_is_not_of_this_sheet_is_refused_before_anything_is_recorded(recorded, capsys):
    out, scan = recorded / "calibrated.toml", recorded / "lies.npz"
    save_surface(scan, Surface(flat_cloud() * np.array([2.0, 1.0, 1.0])[:, None, None]), None, STATED)
    words = ["calibrate", str(recorded / "new.npz"), "--guided", "--port", "/dev/none", "--surface", str(scan)]
    assert main([*words, "--skin", str(recorded / "ours.toml"), "--out", str(out)]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"--surface {scan}: the cloud's sheet is 300 mm along x" in said
    assert not (recorded / "new.npz").exists()


def test_contacts_on_the_edge_are_refused_before_anything_is_read(tmp_path, capsys):
    edge = replace(STATED, electrodes=replace(STATED.electrodes, contact="edge"))
    (tmp_path / "edge.toml").write_text(to_toml(edge))
    words = ["calibrate", "missing.npz", "--skin", str(tmp_path / "edge.toml"), "--out", str(tmp_path / "out.toml")]
    assert main(words) == 1
    assert "contact is 'edge', expected 'patch': contacts on the edge are not calibrated" in capsys.readouterr().err
