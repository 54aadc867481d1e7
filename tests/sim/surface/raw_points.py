"""Points as a scanner gives them: unordered, in any pose, noisy, with holes; and the bends that tests take."""

import numpy as np
from scipy.spatial import cKDTree

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene import bend as bends
from eitskin_sim.scene.scene import Bend, Sheet

SHEET = Sheet()


class Raw:
    """Points of a bend as a scanner would give it, with the pose that nobody tells."""

    def __init__(self, bend, count=20_000, *, noise_mm=0.1, outliers=0.01, holes=(), seed=0):
        rng = np.random.default_rng(seed)
        self.bend = bend
        xy = rng.uniform((0.0, 0.0), SHEET.size_mm, (count, 2))
        for x, y, radius in holes:
            xy = xy[np.hypot(xy[:, 0] - x, xy[:, 1] - y) > radius]
        points = bends.surface(bend, SHEET, xy) + noise_mm * rng.standard_normal((len(xy), 3))
        stray = rng.choice(len(points), int(outliers * len(points)), replace=False)
        points[stray] = rng.uniform(points.min(axis=0) - 20, points.max(axis=0) + 20, (len(stray), 3))
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        self.turn = turn * np.sign(np.linalg.det(turn))
        self.shift = rng.uniform(-300, 300, 3)
        self.points = rng.permutation(self.to_scan(points))

    def to_scan(self, points):
        return points @ self.turn.T + self.shift

    def corner(self, x=0.0, y=0.0):
        return tuple(self.to_scan(bends.surface(self.bend, SHEET, np.array([[x, y]])))[0] + (3.0, -4.0, 2.0))

    def off_and_along(self, result):
        """(1350,) mm off the true surface, and (1350, 2) flat mm between each point's foot and its pixel's centre."""
        in_scan = (result.cloud_mm.reshape(3, -1).T - result.translation_mm) @ result.rotation
        points = (in_scan - self.shift) @ self.turn
        flat = np.stack(np.meshgrid(np.linspace(0, 150, 76), np.linspace(0, 100, 51)), -1).reshape(-1, 2)
        foot = flat[cKDTree(bends.surface(self.bend, SHEET, flat)).query(points)[1]]
        for _ in range(4):  # Gauss-Newton to the foot of the perpendicular
            here = bends.surface(self.bend, SHEET, foot)
            sides = [(bends.surface(self.bend, SHEET, foot + step) - here) / 1e-4 for step in ((1e-4, 0), (0, 1e-4))]
            slope = np.stack(sides, axis=-1)
            gram = np.swapaxes(slope, 1, 2) @ slope
            right = np.einsum("nij,ni->nj", slope, points - here)
            foot = foot + np.linalg.solve(gram, right[..., None])[..., 0]
        off = np.linalg.norm(points - bends.surface(self.bend, SHEET, foot), axis=1)
        return off, foot - PAPER.grid.pixel_centres_mm().reshape(-1, 2)


BENDS = {
    "flat": Bend(),
    "half a turn, stretched": Bend(angle_deg=180, stretch_along=1.19, stretch_across=0.957),
    "300 degrees on a slanted axis": Bend(angle_deg=300, axis_deg=15),
    "skewed": Bend(angle_deg=150, axis_deg=25, skew=0.6, stretch_along=1.1),
    "twisted": Bend(angle_deg=120, axis_deg=-20, skew=-0.4, twist_deg=25, stretch_along=1.1),
    "rolled the other way": Bend(angle_deg=90, axis_deg=90),
    "bumps": Bend(angle_deg=90, axis_deg=10, twist_deg=-20, bumps_mm=((40, 60, 6, 15), (110, 40, -6, 12))),
}
