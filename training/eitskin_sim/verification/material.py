"""Material that lies elsewhere on a surface than its cloud says: a scan without marks shows the surface alone.

A cloud divides rows and columns evenly by arc length between the borders that it sees. True material may be moved
within the surface, by u(x, y) along x and v(x, y) along y, which keep the borders ::

    stretch   d u / d x = a cos(2 pi x / L)                       a layer that gives unevenly
    shift x   d u / d x = b (2 x / L - 1)(2 y / W - 1)            what twist and skew leave, mostly
    shift y   d v / d y = c (2 x / L - 1)(2 y / W - 1)

and the metric is J^T g J with J = 1 + grad (u, v), g taken to vary little over the move. Over family A the last two
are 0.023 and 0.064 (rms), and leave a quarter of the unseen stretch.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.mesh import Metric

Array = npt.NDArray[np.float64]

MATERIAL: Final = ("stretch", "shift x", "shift y")
"""Names of the amplitudes, in their order."""

SHIFT: Final = (0.023, 0.064)
"""Root mean square of b and c over deformations twisted by up to ``TWIST_DEG``."""

TWIST_DEG: Final = 40.0


def spreads_of(skin: Skin = PAPER) -> dict[str, float]:
    """Return how large each amplitude is, over a skin's deformations."""
    bends = skin.deformations
    stretch = max(map(abs, bends.nonuniformity)) / np.sqrt(3.0)
    twist = max(map(abs, bends.twist_deg)) / TWIST_DEG
    return dict(zip(MATERIAL, (float(stretch), SHIFT[0] * twist, SHIFT[1] * twist), strict=True))


def moved(metric: Metric, amplitudes: tuple[float, ...], skin: Skin = PAPER) -> Metric:
    """Return the metric of a sheet whose material lies elsewhere on the same surface.

    Args:
        metric: As the cloud says.
        amplitudes: Of ``MATERIAL``.
        skin: Whose sheet.

    Raises:
        ValueError: An amplitude turns the material inside out.
    """
    if not all(abs(one) < 0.9 for one in amplitudes):
        raise ValueError(f"material moved by {amplitudes}; expected amplitudes below 0.9")
    if not any(amplitudes):
        return metric
    (length, width), (a, b, c) = skin.outline.size_mm, amplitudes

    def found(xy_mm: Array) -> Array:
        x, y = 2.0 * xy_mm[:, 0] / length - 1.0, 2.0 * xy_mm[:, 1] / width - 1.0
        phase = 2.0 * np.pi * xy_mm[:, 0] / length
        E, F, G = metric(xy_mm).T  # there and not at the moved point: a cloud's spline is quick on grids alone
        xx, xy = 1.0 + a * np.cos(phase) + b * x * y, b * length / (2.0 * width) * (x**2 - 1.0)
        yx, yy = c * width / (2.0 * length) * (y**2 - 1.0), 1.0 + c * x * y
        return np.stack(
            [
                E * xx**2 + 2.0 * F * xx * yx + G * yx**2,
                E * xx * xy + F * (xx * yy + xy * yx) + G * yx * yy,
                E * xy**2 + 2.0 * F * xy * yy + G * yy**2,
            ],
            axis=-1,
        )

    return found


def unseen_shifts(true: Metric, shown: Metric, skin: Skin = PAPER) -> tuple[float, float]:
    """Return b and c that take what a cloud shows nearest to the truth, by the stretches along x and along y."""
    (length, width), n = skin.outline.size_mm, 24
    x, y = np.meshgrid((np.arange(n) + 0.5) / n * length, (np.arange(n) + 0.5) / n * width)
    points = np.stack([x.ravel(), y.ravel()], axis=-1)
    form = (2.0 * points[:, 0] / length - 1.0) * (2.0 * points[:, 1] / width - 1.0)
    ratio = np.sqrt(true(points)[:, [0, 2]] / shown(points)[:, [0, 2]]) - 1.0
    b, c = form @ ratio / (form @ form)
    return float(b), float(c)
