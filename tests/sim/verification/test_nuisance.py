"""Nuisance modes against the forward model with the nuisance in it."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Electrodes, Late, Scene, Sheet
from eitskin_sim.verification.material import MATERIAL, moved, unseen_shifts
from eitskin_sim.verification.nuisance import ELEMENT_MM, Modes, modes_of
from eitskin_sim.verification.spreads import Spreads

BEND = Bend(angle_deg=100.0, skew=0.3, twist_deg=10.0, stretch_along=1.1, stretch_across=0.97)
MESH = scene_mesh(replace(Scene(), element_size_mm=ELEMENT_MM))


def volts(sheet: Sheet, bend: Bend = BEND) -> np.ndarray:
    return assemble(MESH, sheet, Electrodes(), bend_metric(bend, sheet)).factorise().voltages()


@pytest.fixture(scope="module")
def modes() -> Modes:
    return modes_of(bend_metric(BEND, Sheet()))


def close(found: np.ndarray, expected: np.ndarray, share: float) -> bool:
    return float(np.linalg.norm(found - expected)) < share * float(np.linalg.norm(expected))


def test_drift_and_gauge_are_the_model_s_own_derivatives(modes: Modes) -> None:
    nominal, step = volts(Sheet()), 1e-3
    drifted = np.log(volts(replace(Sheet(), late=Late(factor=1.0 + step))) / nominal) / np.log(1.0 + step)
    assert close(modes.logs[:, modes.of("drift")], drifted, 2e-3)
    gauge = np.log(volts(replace(Sheet(), gauge_factor=step)) / nominal) / step
    assert close(modes.logs[:, modes.of("gauge")], gauge, 5e-3)


def test_tilts_are_what_the_two_of_them_make_of_any_direction(modes: Modes) -> None:
    late = Late(gradient_rms=1e-3, seed=5)
    tilted = np.log(volts(replace(Sheet(), late=late)) / volts(Sheet())) / 1e-3
    two = modes.logs[:, [modes.of("tilt x"), modes.of("tilt y")]]
    left = tilted - two @ np.linalg.lstsq(two, tilted, rcond=None)[0]
    assert np.linalg.norm(left) < 5e-3 * np.linalg.norm(tilted)


def test_material_that_moves_changes_voltages_as_its_mode_says(modes: Modes) -> None:
    metric = bend_metric(BEND, Sheet())
    for number, name in enumerate(MATERIAL):
        low, high = (
            assemble(MESH, Sheet(), Electrodes(), moved(metric, amplitudes)).factorise().voltages()
            for amplitudes in (tuple(at if one == number else 0.0 for one in range(3)) for at in (-0.01, 0.01))
        )
        assert close(modes.logs[:, modes.of(name)], np.log(high / low) / 0.02, 2e-3), name


def test_stretching_an_even_sheet_is_what_a_bend_s_nonuniformity_does() -> None:
    even = Bend(stretch_along=1.1, stretch_across=0.95)
    points = np.random.default_rng(0).uniform((0.0, 0.0), (150.0, 100.0), (50, 2))
    own = bend_metric(replace(even, nonuniformity=0.11), Sheet())(points)
    assert np.allclose(moved(bend_metric(even, Sheet()), (0.1, 0.0, 0.0))(points), own, rtol=1e-12)


def test_material_turned_inside_out_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected amplitudes below 0\.9"):
        moved(bend_metric(BEND, Sheet()), (0.95, 0.0, 0.0))


def test_shifts_are_found_again() -> None:
    metric = bend_metric(Bend(angle_deg=60.0, stretch_along=1.1), Sheet())
    assert unseen_shifts(moved(metric, (0.0, 0.02, -0.03)), metric) == pytest.approx((0.02, -0.03), rel=0.1)


def test_a_nuisance_without_spread_is_left_out() -> None:
    found = modes_of(bend_metric(Bend(), Sheet()), spreads=Spreads(drift=0.0, gauge=0.0, material=0.0))
    assert found.names == ("tilt x", "tilt y")
    assert found.columns.shape == (104, 2)
    assert found.of("gauge") == -1
