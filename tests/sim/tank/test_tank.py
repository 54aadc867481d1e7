"""From a tank's numbers to its objects: the front end is told, objects are found, and whatever is wrong is one line."""

import numpy as np
import pytest

from eitskin_proto.sensor.table import FULL_TABLE
from eitskin_sim.tank.front_end import fit_front_end
from eitskin_sim.tank.images import IMAGES
from eitskin_sim.tank.model import front_end_of, tank_model
from eitskin_sim.tank.objects import ImageObject, angle_error_deg, find_objects, judge
from eitskin_sim.tank.recording import Object, TankError, load_tank

from . import simulated_tank as tank

SETS = [[(1, "metal")], [(3, "metal"), (7, "plastic")], [(2, "plastic"), (6, "plastic"), (11, "metal"), (15, "metal")]]

NOISE = 10 ** (-36 / 20) / np.sqrt(2)
"""Of rows' changes: in phase, of two frames, each the mean of two."""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("tank") / "tank.npz"
    np.savez(path, **dict(tank.frame(objects, seed) for seed, objects in enumerate(SETS)))
    return path


@pytest.fixture(scope="module")
def frames(file):
    return load_tank(file)


@pytest.fixture(scope="module")
def model(frames):
    return tank_model(frames, widths_deg=(2.0, 12.0))


def test_names_say_what_stands_where(frames):
    assert [[(one.electrode, one.material) for one in frame.objects] for frame in frames] == SETS
    assert frames[0].water_V.shape == (208,)


def change_of(model, frame):
    return front_end_of(model, frame).change(frame.water_V, frame.objects_V)


@pytest.mark.parametrize("solver", IMAGES)
def test_every_object_is_found_in_its_sector_with_its_sign_and_nothing_else(frames, model, solver):
    for frame in frames:
        found = find_objects(model, IMAGES[solver](model, change_of(model, frame)))
        assert len(found) == len(frame.objects)
        assert all(one.right for one in judge(frame.objects, found))
        assert all(abs(one.radius - tank.AT) < 0.2 for one in found)


def test_offset_and_gains_are_those_of_the_front_end():
    rng = np.random.default_rng(1)
    gain, rows = tank.gains(rng), tank.volts((), 4.5)
    found = fit_front_end(tank.read(rows, gain, rng, noise_db=np.inf), rows)
    assert found.offset_V == pytest.approx(tank.OFFSET_V, rel=1e-9)
    assert np.allclose(found.gains, gain, rtol=1e-9)
    assert found.residual < 1e-9
    noisy = fit_front_end(tank.read(rows, gain, rng, noise_db=36.0), rows)
    assert noisy.residual == pytest.approx(10 ** (-36 / 20), rel=0.15)
    assert abs(noisy.offset_V - tank.OFFSET_V) < 0.02 * abs(tank.OFFSET_V)
    assert noisy.reciprocity == pytest.approx(np.sqrt(2) * 10 ** (-36 / 20), rel=0.2)
    twice = [tank.read(rows, gain, rng) for _ in range(2)]
    assert noisy.change(*twice).std() == pytest.approx(NOISE, rel=0.2)


def test_a_front_end_that_cannot_be_told_is_refused():
    with pytest.raises(ValueError, match="offset"):
        fit_front_end(np.full(208, 0.1 + 0j), np.ones(208))


def test_the_electrodes_width_that_explains_the_water_is_taken(frames, model):
    assert model.disc.electrode_width_deg == 12.0
    assert front_end_of(model, frames[0]).residual < 0.025


def test_nothing_changed_is_nothing_found(model):
    for image in IMAGES.values():
        assert find_objects(model, image(model, np.zeros(104))) == []


def test_the_full_table_is_that_of_the_file():
    rows = [
        (s, (s + m) % 16)
        for s in range(16)
        for m in range(16)
        if not {s, (s + 1) % 16} & {(s + m) % 16, (s + m + 1) % 16}
    ]
    assert rows == [tuple(row) for row in FULL_TABLE.tolist()]


def found(angle_deg, material):
    return ImageObject(angle_deg, 0.6, material, 1.0)


def test_an_object_is_right_in_its_own_sector_with_its_own_sign():
    objects = [Object(1, "metal"), Object(5, "plastic"), Object(9, "plastic")]
    judged = judge(objects, [found(350.0, "metal"), found(80.0, "metal"), found(168.0, "plastic")])
    assert [one.right for one in judged] == [True, False, False]  # one off by 12 degrees, and one is left
    assert [one.error_deg for one in judged] == [pytest.approx(10.0), None, pytest.approx(12.0)]
    assert angle_error_deg(Object(9, "metal"), found(0.0, "metal")) == 180.0


@pytest.mark.parametrize(
    ("name", "objects", "unknown"),
    [
        ("electrode01_wood_electrode05_plastic_55ua", [(5, "plastic")], [(1, "wood")]),
        ("electrode01_plasticine_1000hz", [], [(1, "plasticine")]),
        ("electrode03_electrode04_metal", [(4, "metal")], [(3, "")]),
        ("electrode07_2026_03_14", [], [(7, "")]),
        ("saline", [], []),
    ],
)
def test_materials_of_no_known_sign_are_kept_apart(tmp_path, name, objects, unknown):
    np.savez(tmp_path / "tank.npz", **{name: np.ones((208, 4))})
    (frame,) = load_tank(tmp_path / "tank.npz")
    assert [(one.electrode, one.material) for one in frame.objects] == objects
    assert [(one.electrode, one.material) for one in frame.unknown] == unknown


@pytest.mark.parametrize(
    ("name", "array", "said"),
    [
        ("electrode01_metal", np.zeros((104, 4)), "(104, 4)"),
        ("electrode01_metal", np.full((208, 4), np.nan), "not finite"),
        ("electrode01_metal", np.zeros((208, 4)), "zeros"),
        ("electrode17_metal", np.ones((208, 4)), "1 to 16"),
        ("electrode03_metal_electrode03_wood", np.ones((208, 4)), "twice"),
    ],
)
def test_a_frame_that_cannot_be_is_refused_by_name(tmp_path, name, array, said):
    np.savez(tmp_path / "tank.npz", **{name: array})
    with pytest.raises(TankError) as caught:
        load_tank(tmp_path / "tank.npz")
    assert said in str(caught.value)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_without_frames_is_refused(tmp_path):
    np.savez(tmp_path / "tank.npz")
    with pytest.raises(TankError, match="no frame"):
        load_tank(tmp_path / "tank.npz")
