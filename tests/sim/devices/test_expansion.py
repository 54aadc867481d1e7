"""A solved state's slopes are those of devices that are solved, and its 120 values are all of D."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from eitskin_proto.skin.toml import named
from eitskin_sim.devices.device import Device, ideal
from eitskin_sim.devices.expansion import (
    FIRST,
    GAUGE,
    IMPEDANCES,
    LAYER,
    PLACES,
    SECOND,
    SIZES,
    Expansion,
    Fields,
    expansion,
)
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.parts import Bend, LaterChanges, Scene, SmoothField

MM = 6.0
BEND = Bend(angle_deg=60.0, stretch_along=1.05, bumps_mm=((40.0, 30.0, 4.0, 15.0),))
NOMINAL = ideal(named("lab"))


@pytest.fixture(scope="module")
def state() -> Expansion:
    return expansion(NOMINAL, BEND, MM)


def solved(device: Device) -> np.ndarray:
    scene = Scene(device.sheet, device.electrodes, BEND, element_size_mm=MM)
    return np.asarray(factorise_scene(scene).differences())


def test_the_layer_and_the_gauge_factor_move_it_as_they_move_a_solved_sheet(state: Expansion) -> None:
    sheet = replace(
        NOMINAL.sheet, field=SmoothField(2e-3, 40.0, 3), late=LaterChanges(gradient_rms=2e-3, field=None, seed=4)
    )
    uneven, stretching = replace(NOMINAL, sheet=sheet), replace(NOMINAL.sheet, gauge_factor=0.02)
    for device, where, by_how_much in (
        (uneven, LAYER, Fields.of(sheet).parts(sheet, late=True)),
        (replace(NOMINAL, sheet=stretching), GAUGE, 0.02),
    ):
        by = np.zeros(GAUGE + 1)
        by[where] = by_how_much
        moved = np.log(np.abs(solved(device)[FIRST, SECOND])) - state.logs
        assert np.linalg.norm(by @ state.slopes - moved) < 0.05 * np.linalg.norm(moved)


@pytest.mark.parametrize("contact", ["patch", "edge"])
def test_electrodes_move_it_as_they_move_a_sheet_whose_mesh_follows_them(contact: Literal["patch", "edge"]) -> None:
    """Two meshes differ by an error of their own, which two opposite changes have in common."""
    rng = np.random.default_rng(0)
    own, off = replace(NOMINAL.electrodes, contact=contact), rng.standard_normal(16)
    nominal = replace(NOMINAL, electrodes=own)
    state = expansion(nominal, BEND, MM)
    cases = {
        "places": (PLACES, 0.2, lambda by: replace(own, arc_length_mm=tuple(np.add(own.arc_length_mm, by)))),
        "sizes": (SIZES, 0.02, lambda by: replace(own, size_mm=tuple(own.sizes_mm() * np.exp(by)))),
        "impedances": (
            IMPEDANCES,
            0.02,
            lambda by: replace(own, contact_impedance_ohm_m2=tuple(own.impedances_ohm_m2() * np.exp(by))),
        ),
    }
    for name, (where, step, changed) in cases.items():
        more, less = (
            np.log(np.abs(solved(replace(nominal, electrodes=changed(sign * step * off)))[FIRST, SECOND]))
            for sign in (1.0, -1.0)
        )
        moved = (more - less) / 2
        found = step * off @ state.slopes[where]
        assert np.linalg.norm(found - moved) < 0.06 * np.linalg.norm(moved), name
