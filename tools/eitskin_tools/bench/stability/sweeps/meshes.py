"""Meshes that are too coarse, too long or too flat, and what they do to voltages and maps.

The forward model's elements are rectangles: every angle is right, and long ones are what grading makes on purpose. So
the stress is a *slit*, two lines of the mesh as close as numbers allow. Triangles are used only by the independent
solver of the tests; they are put on a problem with a known solution, as needles (one short side, all angles at most
90 degrees) and as caps (one angle towards 180 degrees). What an angle near 180 degrees does is known (Babuska and Aziz,
SIAM J. Numer. Anal. 13, 1976): the gradient along the short direction is interpolated over the long one.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from eitskin_sim.fem.borders.cut_elements import factorise
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Scene
from eitskin_tools.bench.stability.harness.limits import rms, touch_change
from eitskin_tools.bench.stability.harness.rows import Row, crossing, rounded
from eitskin_tools.bench.stability.harness.samples import Sample, voltages_of
from eitskin_tools.bench.stability.harness.sweep import Stress

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

SIZES_MM: Final = (1.5, 2.0, 3.0, 4.5, 6.0, 9.0, 12.0)
ASPECTS: Final = (10.0, 1e2, 1e3, 1e4, 1e6, 1e8, 1e10)
FLATNESS: Final = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)

CELLS: Final = 6
"""Triangles along the side of the closed-form problem."""

ENERGY: Final = 5.6
"""Integral of |grad u|^2 = 9 (x^2 + y^2)^2 over the unit square, for u = x^3 - 3 x y^2."""


def stresses() -> list[Stress]:
    """Return element size and aspect ratio of the forward model's mesh."""
    return [
        Stress("element size", "mm", SIZES_MM, _resized, _explain_size, True, solved=True),
        Stress(
            "aspect ratio, a slit in the mesh", "long over short side", ASPECTS, _slit, _explain_slit, True, solved=True
        ),
    ]


def _resized(sample: Sample, size_mm: float, rng: np.random.Generator) -> Sample:
    return replace(sample, voltages=voltages_of(replace(sample.scene, element_size_mm=size_mm)))


def _error(samples: Sequence[Sample], found: Sequence[Array], exact: Sequence[Array]) -> tuple[float, float]:
    """Return the rms relative error of V, and its share of the touches' dV."""
    apart = [rms((f - e) / e) for f, e in zip(found, exact, strict=True)]
    return float(np.median(apart)), float(
        np.median([a / rms(touch_change(s)) for a, s in zip(apart, samples, strict=True)])
    )


def _explain_size(samples: Sequence[Sample], size_mm: float) -> str:
    few = samples[:2]
    fine = [voltages_of(replace(s.scene, element_size_mm=SIZES_MM[0])) for s in few]
    error, share = _error(few, [_resized(s, size_mm, np.random.default_rng(0)).voltages for s in few], fine)
    return (
        f"at {size_mm:.3g} mm V differs from that at {SIZES_MM[0]:g} mm by {error:.2g} rms, {share:.2g} of what the "
        "touches change"
    )


def _slit(sample: Sample, aspect: float, rng: np.random.Generator) -> Sample:
    return replace(sample, voltages=_with_slit(sample.scene, aspect))


@lru_cache(maxsize=512)
def _with_slit(scene: Scene, aspect: float) -> Array:
    """Return (104,) V on the scene's mesh with two more lines each way, a longest element's size / aspect apart."""
    mesh = scene_mesh(scene)
    lines = []
    for one in (mesh.x_lines_mm, mesh.y_lines_mm):
        steps = np.diff(one)
        at = int(np.argmax(steps))
        middle = (one[at] + one[at + 1]) / 2
        lines.append(np.sort(np.append(one, [middle, middle + steps[at] / aspect])))
    system = assemble(TensorMesh(*lines), scene.sheet, scene.electrodes, bend_metric(scene.bend, scene.sheet))
    return scene.current_A * factorise(system, scene.touches).voltages()


def _explain_slit(samples: Sequence[Sample], aspect: float) -> str:
    plain = [_with_slit(sample.scene, ASPECTS[0]) for sample in samples]
    error, share = _error(samples, [_with_slit(s.scene, aspect) for s in samples], plain)
    return (
        f"at {aspect:.3g} V differs from that at {ASPECTS[0]:g} by {error:.2g} rms, {share:.2g} of what the touches "
        "change: voltages come from differences within elements, so a thin element loses no digits"
    )


def triangle_rows() -> list[Row]:
    """Return the rows of needles and caps: error of the energy of a harmonic polynomial, by flatness."""
    return [_triangle_row("needles", shift=False), _triangle_row("caps", shift=True)]


def _triangle_row(name: str, *, shift: bool) -> Row:
    errors, angles = zip(*(_triangle_error(flat, shift=shift) for flat in FLATNESS), strict=True)
    # Judged like every sweep, with the roundest triangles' error over the error as what is left of the accuracy.
    kept = [errors[0] / error for error in errors]
    broken = crossing(FLATNESS, kept, 0.5, True)
    at = int(np.argmin(np.abs(np.array(FLATNESS) - (broken or FLATNESS[-1]))))
    return {
        "sweep": f"sliver triangles, {name}",
        "solver": "linear triangles",
        "unit": "long over short side",
        "from": FLATNESS[0],
        "to": FLATNESS[-1],
        "unstressed": rounded(errors[0]),
        "worst": rounded(max(errors)),
        "worst_at": FLATNESS[int(np.argmax(errors))],
        "degrades_10pct_at": rounded(crossing(FLATNESS, kept, 0.9, True)),
        "breaks_at": rounded(broken),
        "break_rule": "error of the gradient twice that of the roundest triangles",
        "why": (
            f"the largest angle there is {angles[at]:.4g} degrees, at the end {angles[-1]:.5g}; error {errors[-1]:.3g} "
            f"against {errors[0]:.3g}; the forward model's rectangles keep 90 degrees"
        ),
    }


def _triangle_error(flat: float, *, shift: bool) -> tuple[float, float]:
    """Return the relative error of the gradient of x^3 - 3 x y^2 on the unit square, and the largest angle in degrees.

    Args:
        flat: Width of a triangle over its height.
        shift: Every second row is moved by half a width, which makes caps of needles.
    """
    points, triangles = _rows_of_triangles(CELLS, round(CELLS * flat), shift=shift)
    x, y = points.T
    corners = points[triangles]
    edges = np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1)  # (t, 3, 2) against each corner
    twice = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    slopes = np.stack([edges[..., 1], -edges[..., 0]], axis=-1) / twice[:, None, None]  # of the three hat functions
    stiffness = 0.5 * np.abs(twice)[:, None, None] * (slopes @ np.swapaxes(slopes, 1, 2))
    rows, columns = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, (1, 3)).ravel()
    matrix = coo_array((stiffness.ravel(), (rows, columns)), (len(points), len(points))).tocsr()
    found = x**3 - 3.0 * x * y**2
    inside = np.flatnonzero((x > 0.0) & (x < 1.0) & (y > 0.0) & (y < 1.0))
    found[inside] = 0.0
    found[inside] = splu(matrix[inside][:, inside].tocsc()).solve(-(matrix @ found)[inside])
    gradient = np.einsum("ti,tia->ta", found[triangles], slopes)
    middles = (corners + np.roll(corners, 1, axis=1)) / 2
    mx, my = middles[..., 0], middles[..., 1]
    exact = np.stack([3.0 * (mx**2 - my**2), -6.0 * mx * my], axis=-1)
    square = np.sum((gradient[:, None, :] - exact) ** 2, axis=-1).mean(axis=1)
    error = np.sqrt(np.sum(0.5 * np.abs(twice) * square) / ENERGY)
    sides = np.sort(np.linalg.norm(edges, axis=2), axis=1)
    cosine = (sides[:, 0] ** 2 + sides[:, 1] ** 2 - sides[:, 2] ** 2) / (2.0 * sides[:, 0] * sides[:, 1])
    return float(error), float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max())


def _rows_of_triangles(nx: int, ny: int, *, shift: bool) -> tuple[Array, Index]:
    """Return (n, 2) points and (t, 3) triangles of the unit square in ny rows, each strip filled from left to right."""
    even = np.arange(nx + 1) / nx
    odd = np.concatenate([[0.0], (np.arange(nx) + 0.5) / nx, [1.0]]) if shift else even
    levels = [odd if row % 2 else even for row in range(ny + 1)]
    first = np.cumsum([0, *(len(level) for level in levels)])
    points = np.concatenate([np.stack([x, np.full_like(x, row / ny)], -1) for row, x in enumerate(levels)])
    triangles = []
    for row, (low, high) in enumerate(pairwise(levels)):
        i = j = 0
        while i < len(low) - 1 or j < len(high) - 1:
            here = (first[row] + i, first[row + 1] + j)
            if j == len(high) - 1 or (i < len(low) - 1 and low[i + 1] <= high[j + 1]):
                i += 1
                triangles.append((*here, first[row] + i))
            else:
                j += 1
                triangles.append((*here, first[row + 1] + j))
    return points, np.array(triangles, dtype=np.intp)
