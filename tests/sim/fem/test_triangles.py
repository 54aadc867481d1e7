"""Triangles of scikit-fem, refined towards the electrodes, solve the same equations as the sheet's own elements."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.sparse import bmat, csc_array
from scipy.sparse.linalg import splu

from eitskin_proto.sensor.table import TABLE
from eitskin_sim.fem.contacts import FRINGE_SHARE
from eitskin_sim.fem.mesh import MM
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.parts import Electrodes, Scene

Array = npt.NDArray[np.float64]

pytestmark = pytest.mark.heavy


def test_independent_triangles_give_the_same_voltages_with_edge_electrodes() -> None:
    pytest.importorskip("skfem", reason="the independent solver comes with the extra 'dev'")
    scene = Scene(electrodes=Electrodes("edge"))
    found, unknowns = solve_triangles(scene)
    assert unknowns > 10_000
    # 8e-6 was measured; with lines 5 mm apart the triangles themselves are off by 4e-5.
    np.testing.assert_allclose(solve_scene(scene).voltages, found, rtol=3e-5)


def solve_triangles(scene: Scene, spacing_mm: float = 3.0, rounds: int = 14) -> tuple[Array, int]:
    """Return the (104,) V of a flat, untouched scene under 1 A by the constant contact law, and the unknowns.

    Args:
        scene: No electrode may go round a corner.
        spacing_mm: Of the triangles far from electrodes.
        rounds: Of refinement towards the electrodes and their edges.
    """
    import skfem
    from skfem.models import poisson

    patch = scene.electrodes.contact == "patch"
    depths = scene.electrodes.sizes_mm() if patch else np.zeros(16)
    pieces = place(scene.sheet, scene.electrodes)
    boxes = np.array([piece.patch_mm(scene.sheet, float(depths[piece.electrode])) for piece in pieces])
    mesh = _mesh(scene, boxes, spacing_mm, rounds)
    basis = skfem.Basis(mesh, skfem.ElementTriP2())
    thickness = scene.sheet.thickness_mm * MM
    stiffness = scene.sheet.conductivity_S_per_m * thickness * poisson.laplace.assemble(basis)
    fringe = FRINGE_SHARE * thickness / scene.sheet.conductivity_S_per_m if patch else 0.0
    densities = (MM**2 if patch else thickness * MM) / (scene.electrodes.impedances_ohm_m2() + fringe)
    border = mesh.boundary_facets()
    parts = (mesh.p[:, mesh.t].mean(axis=1), mesh.p[:, mesh.facets[:, border]].mean(axis=1))
    loads = []
    for box, density in zip(boxes, densities, strict=True):
        low, high = box[:2, None] - 1e-9, box[2:, None] + 1e-9
        inside = [np.flatnonzero(np.all((part >= low) & (part <= high), axis=0)) for part in parts]
        contact: Any = (
            skfem.Basis(mesh, skfem.ElementTriP2(), elements=inside[0])
            if patch
            else skfem.FacetBasis(mesh, skfem.ElementTriP2(), facets=border[inside[1]])
        )
        stiffness = stiffness + density * poisson.mass.assemble(contact)
        loads.append(density * poisson.unit_load.assemble(contact))
    return _voltages(stiffness, np.array(loads)), stiffness.shape[0]


def _mesh(scene: Scene, boxes: Array, spacing_mm: float, rounds: int) -> Any:
    """Refine where triangles are large for their distance from an electrode, and from its corners or ends."""
    import skfem

    lines = []
    for axis, extent in enumerate(scene.sheet.size_mm):
        even = np.linspace(0.0, extent, round(extent / spacing_mm) + 1)
        lines.append(np.unique(np.round(np.concatenate([even, boxes[:, axis], boxes[:, axis + 2]]), 9)))
    mesh = skfem.MeshTri.init_tensor(*lines)
    least_at_edge, least = (0.1, 0.1) if scene.electrodes.contact == "patch" else (0.02, 0.08)
    for _ in range(rounds):
        corners = mesh.p[:, mesh.t]
        middle, size = corners.mean(axis=1)[:, None], np.ptp(corners, axis=1).max(axis=0)
        low, high = boxes[:, :2].T[:, :, None], boxes[:, 2:].T[:, :, None]
        outside = np.maximum(low - middle, middle - high)  # (2, electrodes, triangles), negative inside
        off = np.linalg.norm(np.maximum(outside, 0.0), axis=0)
        rim = np.where(off > 0.0, off, np.min(-outside, axis=0)).min(axis=0)
        ends = [np.stack([boxes[:, i], boxes[:, j]])[:, :, None] for i in (0, 2) for j in (1, 3)]
        tip = np.min([np.linalg.norm(middle - end, axis=0).min(axis=0) for end in ends], axis=0)
        wanted = np.minimum(np.maximum(0.5 * tip, least_at_edge), np.inf)
        coarse = (size > wanted) & (size > np.maximum(0.5 * rim, least))
        if not coarse.any():
            break
        mesh = mesh.refined(np.flatnonzero(coarse))
    return mesh


def _voltages(stiffness: Any, loads: Array) -> Array:
    blocks: Any = [[stiffness, -loads[:-1].T], [-loads[:-1], np.diag(loads[:-1].sum(axis=1))]]
    matrix = csc_array(bmat(blocks))
    n = stiffness.shape[0]
    currents = np.zeros((n + 15, 15))
    currents[n:] = np.eye(15)
    impedance = np.zeros((16, 16))
    lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    impedance[:15, :15] = lu.solve(currents)[n:]
    drives = impedance - np.roll(impedance, -1, axis=1)
    measured = (drives - np.roll(drives, -1, axis=0)).T
    return np.asarray(measured[TABLE[:, 0], TABLE[:, 1]])
