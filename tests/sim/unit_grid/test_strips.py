"""What is shared or skipped in condensing units and inverting their skeleton changes no digit that matters."""

import numpy as np
import pytest

from eitskin_proto.skin.parts import Map
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.unit_grid.skeleton import assemble_skeleton, condense_at, condense_units, unit_system_of
from eitskin_sim.unit_grid.strips import inverse_by_strips
from eitskin_sim.unit_grid.unit_mesh import unit_lines
from eitskin_sim.unit_grid.units import inverse

BEND = Bend(angle_deg=80.0, axis_deg=30.0, twist_deg=10.0, stretch_along=1.1)
SKINS = {
    "wide": Skin(name="wide", map=Map((12, 18), (4, 6))),
    "tall": Skin(name="tall", map=Map((12, 12), (6, 4))),
    "an electrode over several small units": Skin(name="fine", map=Map((30, 45), (3, 45))),
}


@pytest.mark.parametrize("name", SKINS)
def test_strips_have_the_inverse_of_the_whole_up_to_a_constant(name: str) -> None:
    skin = SKINS[name]
    parts, system = unit_system_of(bend_metric(BEND, Sheet()), skin=skin)
    units = condense_units(parts, system, (system.background,))
    whole = inverse(assemble_skeleton(units, len(parts.skeleton) + 16))
    renumbered, found, terminals = inverse_by_strips(parts, units)
    place = np.empty(len(whole), dtype=np.intp)
    for before, after in zip(units, renumbered, strict=True):
        place[before.dofs] = after.dofs
    assert np.array_equal(place[-16:], terminals)
    currents = np.random.default_rng(0).normal(size=(len(whole), 5))
    currents -= currents.mean(axis=0)
    expected, own = whole @ currents, (found[np.ix_(place, place)] @ currents)
    assert own - own.mean(axis=0) == pytest.approx(expected - expected.mean(axis=0), rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("unit", [0, 1, 8])
def test_a_unit_at_many_conductivities_is_what_it_is_at_each(unit: int) -> None:
    parts, system = unit_system_of(bend_metric(BEND, Sheet()), skin=SKINS["wide"])
    sigmas = (0.1, 1.0, 50.0)
    together = condense_at(unit, parts, system, sigmas).schur
    for sigma, found in zip(sigmas, together, strict=True):
        alone = condense_at(unit, parts, system, (sigma,)).schur[0]
        assert found == pytest.approx(alone, rel=1e-9, abs=1e-12 * np.abs(alone).max())


def test_a_coarse_mesh_s_lines_are_among_the_fine_one_s_and_hold_every_edge() -> None:
    edges = (0.0, 7.5, 17.5, 31.0, 41.0)
    fine, coarse = unit_lines(150.0, 14, edges), unit_lines(150.0, 14, edges, coarse=True)
    assert np.isin(coarse, fine).all()
    assert np.isin(edges, coarse).all()
    assert np.isin(np.round(np.linspace(0.0, 150.0, 15), 9), coarse).all()
    assert len(coarse) < 0.75 * len(fine)
    assert PAPER.grid.units == (9, 14)
