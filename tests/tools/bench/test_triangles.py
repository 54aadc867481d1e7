"""Somebody else's triangles, refined towards the electrodes, solve the same equations as the sheet's own elements."""

import numpy as np
import pytest

from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.parts import Electrodes, Scene
from eitskin_tools.bench.physics import solve_triangles

pytestmark = pytest.mark.heavy


def test_independent_triangles_give_the_same_voltages_with_edge_electrodes() -> None:
    pytest.importorskip("skfem", reason="the independent solver comes with the extra 'dev'")
    scene = Scene(electrodes=Electrodes("edge"))
    found, unknowns = solve_triangles(scene)
    assert unknowns > 10_000
    # 8e-6 was measured; with lines 5 mm apart the triangles themselves are off by 4e-5.
    np.testing.assert_allclose(solve_scene(scene).voltages, found, rtol=3e-5)
