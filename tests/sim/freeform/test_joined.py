"""Touches that share elements: what one of them alone does is taken from it, and is what it is among the others."""

from dataclasses import fields

import numpy as np
import pytest

from eitskin_sim.fem.borders.cut_touches import Cuts
from eitskin_sim.freeform.joined import joined_geometry
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.freeform.parts import geometry, reached
from eitskin_sim.freeform.presses import pool_of
from eitskin_sim.scene.touch_table import TouchTable, gather


def rows(cuts: Cuts) -> np.ndarray:
    """Return the order of rows by kind of element (cut, graded, whole), part and element."""
    kind = np.repeat([0, 1, 2], [cuts.n_cut, cuts.n_graded, len(cuts.element) - cuts.n_cut - cuts.n_graded])
    return np.lexsort((cuts.element, cuts.of_set, kind))


@pytest.mark.parametrize("kind", ["hard", "press", "both"])
def test_joined_touches_are_as_if_all_were_integrated_together(kind: str) -> None:
    grid = shared_mesh()
    parts = pool_of(kind, 40, np.random.default_rng(3))
    batches = geometry(parts, grid)
    bits = reached(batches, grid.mesh.n_elements)
    sharing = np.argwhere(np.triu((bits[:, None] & bits).any(axis=2), 1))
    assert len(sharing) > 8
    groups = [(int(a), int(b)) for a, b in sharing[:8]] + [(0, 17, 39)]
    together = gather([np.concatenate([parts.of(part) for part in group]) for group in groups])
    for one, other in zip(joined_geometry(parts, batches, groups, grid), geometry(together, grid), strict=True):
        a, b = rows(one.cuts), rows(other.cuts)
        assert (one.cuts.n_cut, one.cuts.n_graded) == (other.cuts.n_cut, other.cuts.n_graded)
        assert np.array_equal(one.signs, other.signs)
        assert np.array_equal(one.layout.dofs, other.layout.dofs)
        for name in ("of_set", "element", "sigma", "share"):
            assert getattr(one.cuts, name)[a] == pytest.approx(getattr(other.cuts, name)[b], rel=1e-12), name
        cut, graded = slice(one.cuts.n_cut), slice(one.cuts.n_cut, one.cuts.n_cut + one.cuts.n_graded)
        for name in (field.name for field in fields(one.cuts.integrals)):
            mine, theirs = getattr(one.cuts.integrals, name)[a[cut]], getattr(other.cuts.integrals, name)[b[cut]]
            assert mine == pytest.approx(theirs, rel=1e-10, abs=1e-12), name
        if one.cuts.graded is not None:
            assert other.cuts.graded is not None
            first = one.cuts.n_cut
            for name, axis in (("added", 0), ("coupling", 1), ("corner", 1), ("centroid", 0), ("sigma", 0)):
                mine = np.take(getattr(one.cuts.graded, name), a[graded] - first, axis)
                theirs = np.take(getattr(other.cuts.graded, name), b[graded] - first, axis)
                assert mine == pytest.approx(theirs, rel=1e-10, abs=1e-12), name


def test_no_groups_are_no_parts() -> None:
    parts = TouchTable(np.zeros((0, 8)), np.zeros(1, dtype=np.int64))
    assert joined_geometry(parts, geometry(parts, shared_mesh()), [], shared_mesh()) == []
