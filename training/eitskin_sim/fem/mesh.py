"""A rectangular mesh of biquadratic elements whose lines follow electrodes and touches, and crowd at their edges.

Nodes are numbered along x first; an element's nine nodes in the same order::

    6---7---8        size(x) = min(cap, size_a + g (x - a), size_b + g (b - x))   between two fixed lines
    |   |   |
    3   4   5        lines stand at equal steps of the integral of dx / size, which is known in closed form: the cells
    |   |   |        form geometric series from both ends, and half the element size halves every cell.
    0---1---2
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array, Index
from eitskin_sim.scene.parts import SceneError

Metric = Callable[[Array], Array]
"""(n, 2) flat points in mm -> (n, 3) first fundamental form E, F, G per mm^2 of the flat sheet."""

MM: Final = 1e-3
"""Metres in a millimetre."""

GROWTH_PER_MM: Final = 0.8
"""Growth of the element's size per mm of distance from a fixed line; neighbours differ by about exp(0.8) at most."""

MAX_FIXED_LINES: Final = 3000
"""Most fixed lines along one direction, because each is compared with each."""

MERGE_MM: Final = 1e-6
"""Fixed lines nearer than this are one line."""


@dataclass(frozen=True, slots=True)
class TensorMesh:
    """A tensor-product mesh of the flat sheet.

    Args:
        x_lines_mm: (nx + 1,) ascending.
        y_lines_mm: (ny + 1,) ascending.
    """

    x_lines_mm: Array
    y_lines_mm: Array
    element_nodes: Index = field(init=False, repr=False)
    """(n_elements, 9) node numbers; element ey * nx + ex."""
    sizes_mm: Array = field(init=False, repr=False)
    """(n_elements, 2) width along x and height along y."""
    corners_mm: Array = field(init=False, repr=False)
    """(n_elements, 2) lower left corners."""
    centres_mm: Array = field(init=False, repr=False)
    """(n_elements, 2) middles."""
    reach_mm: Array = field(init=False, repr=False)
    """(n_elements,) from the middle to a corner."""

    def __post_init__(self) -> None:
        for name in ("x_lines_mm", "y_lines_mm"):
            lines = np.asarray(getattr(self, name), dtype=np.float64)
            if lines.ndim != 1 or len(lines) < 2 or not np.all(np.diff(lines) > 0.0):
                raise ValueError(f"{name} must be ascending numbers, at least 2; found shape {lines.shape}")
            object.__setattr__(self, name, lines)
        ny, nx = self.shape
        first = 2 * np.arange(ny)[:, None] * (2 * nx + 1) + 2 * np.arange(nx)
        local = np.arange(3)[:, None] * (2 * nx + 1) + np.arange(3)
        object.__setattr__(self, "element_nodes", first.reshape(-1, 1) + local.reshape(1, 9))
        sizes = _pairs(np.diff(self.x_lines_mm), np.diff(self.y_lines_mm))
        corners = _pairs(self.x_lines_mm[:-1], self.y_lines_mm[:-1])
        made = {"sizes_mm": sizes, "corners_mm": corners, "centres_mm": corners + sizes / 2}
        for name, values in (made | {"reach_mm": np.hypot(*sizes.T) / 2}).items():
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    @property
    def shape(self) -> tuple[int, int]:
        """Elements along y, elements along x."""
        return len(self.y_lines_mm) - 1, len(self.x_lines_mm) - 1

    @property
    def n_elements(self) -> int:
        """Number of elements."""
        return self.shape[0] * self.shape[1]

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return (2 * self.shape[0] + 1) * (2 * self.shape[1] + 1)

    @property
    def nodes_mm(self) -> Array:
        """(n_nodes, 2) positions."""
        return _pairs(with_middles(self.x_lines_mm), with_middles(self.y_lines_mm))


def _pairs(x: Array, y: Array) -> Array:
    """Return (n, 2) all pairs, along x first."""
    along_x, along_y = np.meshgrid(x, y)
    return np.stack([along_x.ravel(), along_y.ravel()], axis=-1)


def with_middles(lines: Array) -> Array:
    """Return the (2 m - 1,) positions of nodes along one direction of m lines."""
    found = np.empty(2 * len(lines) - 1)
    found[::2] = lines
    found[1::2] = (lines[:-1] + lines[1:]) / 2
    return found


def graded_lines(fixed: Sequence[tuple[float, float]], cap_mm: float, density: float = 1.0) -> Array:
    """Return the lines of a mesh along one direction.

    Args:
        fixed: Positions that lines must have, each with the element size beside it, mm; the sheet's ends too.
        cap_mm: The largest element.
        density: Multiplies the number of elements between fixed lines, without moving those.
    """
    positions, sizes = _merged(fixed, cap_mm)
    lines = [positions[:1]]
    for a, b, size_a, size_b in zip(positions, positions[1:], sizes, sizes[1:], strict=False):
        lines.append(_between(float(a), float(b), float(size_a), float(size_b), cap_mm, density))
    return np.concatenate(lines)


def _merged(fixed: Sequence[tuple[float, float]], cap_mm: float) -> tuple[Array, Array]:
    ordered = sorted(fixed)
    positions, sizes = [ordered[0][0]], [ordered[0][1]]
    for position, size in ordered[1:]:
        if position - positions[-1] <= MERGE_MM:
            sizes[-1] = min(sizes[-1], size)
        else:
            positions.append(position)
            sizes.append(size)
    if len(positions) > MAX_FIXED_LINES:
        raise SceneError(
            f"touches and electrodes ask for {len(positions)} lines of the mesh, expected at most {MAX_FIXED_LINES}"
        )
    where, size_there = np.array(positions), np.minimum(sizes, cap_mm)
    spread = size_there[:, None] + GROWTH_PER_MM * np.abs(where[:, None] - where)
    return where, spread.min(axis=0)


def _between(a: float, b: float, size_a: float, size_b: float, cap: float, density: float) -> Array:
    """Return the lines after ``a`` up to ``b``."""
    meet = (b - a) / 2 + (size_b - size_a) / (2 * GROWTH_PER_MM)  # where the two ramps cross, measured from a
    top = min(cap, size_a + GROWTH_PER_MM * meet)
    ramp_a, ramp_b = np.log(top / size_a) / GROWTH_PER_MM, np.log(top / size_b) / GROWTH_PER_MM
    length_a, length_b = (top - size_a) / GROWTH_PER_MM, (top - size_b) / GROWTH_PER_MM
    flat = max((b - a - length_a - length_b) / top, 0.0)
    total = ramp_a + flat + ramp_b
    count = max(1, int(np.ceil(total * density - 1e-9)))
    step = total * np.arange(1, count + 1) / count
    rising = a + size_a * np.expm1(GROWTH_PER_MM * np.minimum(step, ramp_a)) / GROWTH_PER_MM
    level = rising + top * np.clip(step - ramp_a, 0.0, flat)
    falling = b - size_b * np.expm1(GROWTH_PER_MM * (total - np.maximum(step, ramp_a + flat))) / GROWTH_PER_MM
    lines = np.where(step < ramp_a + flat, level, falling)
    lines[-1] = b
    return np.asarray(lines)
