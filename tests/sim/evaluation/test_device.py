"""Mismatches say how far, devices which way: the ideal one is the nominal sheet, and every solver assumes that one."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from eitskin_proto.skin import toml
from eitskin_proto.skin.cloud import align_cloud
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation.device import draw_device
from eitskin_sim.evaluation.mismatch import (
    BOUNDS,
    IDEAL,
    LAB,
    Mismatch,
    deviations,
    lab_rows,
    load_rows,
    random_mismatch,
    random_rows,
)
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.scene import SceneError, check_scene
from eitskin_sim.scene.shapes import Disc, Rect
from eitskin_sim.surface.measured_cloud import measured_cloud

BENT = draw("A", 1, 0)[0]
SCENE = Scene(bend=BENT, touches=(Touch((Rect(60.0, 40.0, 75.0, 55.0),)), Touch((Disc(30.0, 30.0, 6.0),))))
ALL = Mismatch(
    1.0, 3.0, 10.0, 0.5, 1.5, 148.0, 0.05, 30.0, 1.0, 5.0, 0.02, 10.0, 2.0, 1.0, 0.05, 0.3, 5.0, 1.01, True, 0.01, True,
    60.0, 1.0, 0.01, 40.0, 0.7, 0.3, 0.4,
)  # fmt: skip


def rng():
    return np.random.default_rng(3)


def test_of_any_skin_it_is_what_the_skin_states():
    skin = toml.load(Path(__file__).parents[3] / "docs" / "examples" / "skin.toml")
    bend = draw("A", 1, 0, skin)[0]
    nominal = nominal_scene(skin, bend, SCENE.touches)
    device = draw_device(IDEAL, 0, 0, skin)
    scene = device.scene(nominal, as_it_is=False)
    assert (scene.sheet, scene.bend, scene.touches) == (nominal.sheet, bend, SCENE.touches)
    assert scene.electrodes.arc_length_mm == nominal.electrodes.arc_length_mm
    assert np.array_equal(scene.electrodes.sizes_mm(), nominal.electrodes.sizes_mm())
    assert np.array_equal(device.cloud(bend, rng()), measured_cloud(bend, rng(), skin=skin).astype(np.float64))
    for number in range(5):
        off = random_mismatch(np.random.default_rng(number), skin)
        assert 0.75 * 1.5 <= off.thickness_mm <= 1.25 * 1.5
        assert 0.75 * 5.0 <= off.electrode_size_mm <= 1.25 * 5.0
        one = draw_device(off, 0, number, skin)
        assert abs(one.longer - 1.0) <= 0.01
        check_scene(one.scene(nominal, as_it_is=False))


def test_every_deviation_is_there_and_the_scene_can_be_solved():
    assert len(deviations(ALL)) == len(fields(Mismatch)) - 1  # scan is as it should be
    device = draw_device(ALL, 0, 1)
    scene = device.scene(SCENE, as_it_is=False)
    check_scene(scene)
    assert scene.sheet.size_mm == (148.0, 100.0)
    assert (scene.sheet.thickness_mm, scene.sheet.gauge_factor) == (1.5, 1.0)
    assert (scene.sheet.field.rms, scene.sheet.field.correlation_mm) == (0.05, 30.0)
    assert (scene.sheet.late.factor, scene.sheet.late.gradient_rms) == (1.05, 0.02)
    assert scene.electrodes.size_mm == 3.0
    assert all((one.contrast, one.border_mm, one.dent_mm) == (10.0, 2.0, 1.0) for one in scene.touches)
    assert scene.bend.nonuniformity == BENT.nonuniformity + 0.05
    as_they_are = device.scene(SCENE, as_it_is=True).touches
    assert [one.contrast for one in as_they_are] == [None, None]
    assert as_they_are[0].shapes[0].x1_mm == pytest.approx(75.0 * 148 / 150)


def test_a_scan_shows_what_the_scanner_does():
    def cloud(**off):
        return draw_device(Mismatch(**off), 0, 0).cloud(BENT, rng())

    exact = measured_cloud(BENT)
    assert (cloud(scan_noise_mm=1.0) - exact).std() == pytest.approx(1.0, rel=0.1)
    assert np.allclose(cloud(scan_scale=1.01), 1.01 * cloud(), atol=1e-3)
    assert cloud(scan=False) is None
    stale = cloud(scan_noise_mm=0.0, scan_stale_deg=90.0)
    assert np.abs(align_cloud(stale) - exact).max() > 1.0
    flat = align_cloud(draw_device(Mismatch(scan_noise_mm=0.0, length_mm=153.0), 0, 0).cloud(Bend(), rng()))
    assert np.ptp(flat[0]) == pytest.approx(1.02 * np.ptp(measured_cloud(Bend())[0]), rel=1e-4)
    unseen = cloud(unseen_stretch=0.2, scan_noise_mm=0.0)
    assert np.array_equal(unseen, cloud(scan_noise_mm=0.0))


def test_random_devices_lie_within_the_bounds_and_leave_touches_as_they_are():
    for number in range(50):
        off = random_mismatch(np.random.default_rng(number))
        for name, (low, high) in BOUNDS.items():
            value = getattr(off, name)
            assert value is None or low <= value <= high, name
        assert off.contrast is None
        if number < 3:
            check_scene(draw_device(off, 0, number).scene(SCENE, as_it_is=False))
    assert [name for name, _ in random_rows()] == ["none", "random"]
    assert dict(lab_rows())["lab mix"] == LAB


def written(tmp_path, value):
    path = tmp_path / "devices.json"
    path.write_text(json.dumps(value))
    return path


def test_rows_come_from_json(tmp_path):
    rows = load_rows(written(tmp_path, [{"name": "a", "gauge_factor": 1}, {"scan": False, "contrast": 0.5}]))
    assert rows[0] == ("a", Mismatch(gauge_factor=1.0))
    assert rows[1][1] == Mismatch(scan=False, contrast=0.5)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ([{"gauge": 1}], "unknown key 'gauge'"),
        ([{"gauge_factor": 9}], "devices[0].gauge_factor"),
        ([{}, {"contrast": 1}], "devices[1] changes nothing: its contrast is 1"),
        ([{"field_mm": 30}], "devices[0].field_mm does nothing without field_rms"),
        ([], "list of 1 to 200 mismatches"),
    ],
)
def test_rows_that_cannot_be_are_refused(tmp_path, value, said):
    path = written(tmp_path, value)
    with pytest.raises(SceneError) as caught:
        load_rows(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))


# An offset is stated of a layer of 1 S/m: of one that conducts a fifth of that, readings are five times as large.
def test_an_offset_is_as_large_a_share_of_the_readings_whatever_the_layer_conducts() -> None:
    worse = replace(PAPER, layer=replace(PAPER.layer, conductivity_S_per_m=Quantity(0.2)))
    off = Mismatch(offset_V=0.01)
    one, other = (np.array(draw_device(off, 0, 0, skin).front_end.offset_per_pair_V) for skin in (PAPER, worse))
    assert np.abs(one).max() > 0.005
    assert other == pytest.approx(5.0 * one)
