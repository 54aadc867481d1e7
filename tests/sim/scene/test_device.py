"""Uneven layers at flat points: their law over seeds, their independence of any mesh, and the JSON that says so."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eitskin_sim.scene.layer import (
    gauge,
    is_uneven,
    relative_conductivity,
    smooth_field,
)
from eitskin_sim.scene.parts import LaterChanges, Sheet, SmoothField
from eitskin_sim.scene.scene import SceneError, parse_scene, scene_json

POINTS = np.stack(np.meshgrid(np.linspace(0.0, 150.0, 31), np.linspace(0.0, 100.0, 21)), axis=-1)
"""(21, 31, 2) mm."""


def test_a_field_is_a_function_of_the_point_alone() -> None:
    field = SmoothField(0.1, 30.0, 5)
    whole = smooth_field(field, POINTS)
    assert whole.shape == (21, 31)
    np.testing.assert_array_equal(smooth_field(field, POINTS[3:4, 7]), whole[3:4, 7])
    np.testing.assert_array_equal(smooth_field(field, np.tile(POINTS.reshape(-1, 2), (60, 1)))[-651:], whole.ravel())
    assert np.abs(whole - smooth_field(replace(field, seed=6), POINTS)).max() > 0.05


def test_fields_have_their_rms_and_correlation_over_seeds() -> None:
    rms, length, at = 0.2, 40.0, np.array([0.0, 20.0, 40.0, 80.0, 150.0])
    points = np.stack([at, 0.6 * at], axis=-1)
    apart = np.hypot(*points.T)
    found = np.array([smooth_field(SmoothField(rms, length, seed), points) for seed in range(4000)])
    assert np.abs(found.mean(axis=0)).max() < 4 * rms / np.sqrt(4000)
    np.testing.assert_allclose(found.std(axis=0), rms, rtol=0.05)
    law = np.exp(-(apart**2) / (2.0 * length**2))
    np.testing.assert_allclose((found[:, :1] * found).mean(axis=0) / rms**2, law, atol=0.06)
    kurtosis = (found**4).mean() / (found**2).mean() ** 2
    assert kurtosis == pytest.approx(3.0, abs=0.15)  # as a normal draw's


def test_the_gauge_is_a_power_of_the_area_stretch() -> None:
    metric = np.array([[1.3**2, 0.0, 0.9**2], [1.0, 0.0, 1.0], [2.0, 1.0, 1.0]])
    for k in (-2.0, 0.0, 1.5):
        np.testing.assert_allclose(gauge(Sheet(gauge_factor=k), metric), [(1.3 * 0.9) ** -k, 1.0, 1.0], rtol=1e-14)
    sheet = Sheet(gauge_factor=2.0, late=LaterChanges(1.1))
    assert relative_conductivity(sheet, POINTS[0, :3], metric)[0] == pytest.approx(1.1 / 1.17**2, rel=1e-12)
    assert is_uneven(sheet)
    assert not is_uneven(Sheet())


DEVICE: dict[str, Any] = {
    "sheet": {
        "gauge_factor": 1.0,
        "field": {"rms": 0.05, "correlation_mm": 40, "seed": 3},
        "late": {"factor": 1.08, "gradient_rms": 0.02, "field": {"rms": 0.01, "correlation_mm": 60, "seed": 4}},
    },
    "electrodes": {
        "size_mm": [4.0 + 0.1 * (k % 3) for k in range(16)],
        "contact_impedance_ohm_m2": [1e-4 * (1 + k % 5) for k in range(16)],
        "arc_length_mm": [12.5 + 31.25 * k + 0.5 * (-1) ** k for k in range(16)],
    },
}


def test_a_device_is_read_and_survives_its_own_json() -> None:
    scene = parse_scene(DEVICE)
    assert scene.sheet.late == LaterChanges(1.08, 0.02, SmoothField(0.01, 60.0, 4))
    assert scene.electrodes.sizes_mm()[1] == 4.1
    assert scene.electrodes.impedances_ohm_m2()[4] == 5e-4
    assert parse_scene(json.loads(scene_json(scene))) == scene
    assert hash(scene) == hash(parse_scene(DEVICE))
    assert scene.reference().sheet == replace(scene.sheet, late=None)


def test_an_ideal_sheets_json_knows_nothing_of_devices() -> None:
    assert set(json.loads(scene_json(parse_scene({})))["sheet"]) == {"size_mm", "thickness_mm", "conductivity_S_per_m"}


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        ({"sheet": {"gauge_factor": 6}}, r"sheet\.gauge_factor is 6, expected a number from -5 to 5"),
        ({"sheet": {"field": 0.05}}, r"sheet\.field is 0.05, expected a table"),
        ({"sheet": {"field": {"rms": 0.05}}}, "lacks correlation_mm, expected a number from 5 to"),
        (
            {"sheet": {"late": {"gradient": 0.1}}},
            "unknown key 'gradient' in .*; did you mean 'gradient_rms'",
        ),
        ({"electrodes": {"size_mm": [4] * 8 + [40, 30] + [4] * 6}}, "8 and 9 overlap: .* at least 35 mm"),
    ],
)
def test_a_device_that_cannot_be_is_refused_in_one_line(scene: object, says: str) -> None:
    with pytest.raises(SceneError, match=says) as caught:
        parse_scene(scene)
    assert "\n" not in str(caught.value)
