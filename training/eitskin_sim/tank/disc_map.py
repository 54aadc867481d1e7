"""The conformal map between a square and a disc, by Jacobi's elliptic functions.

::

    square (x, y) mm           w = K (2 x / L - 1 + 2 i y / L)         2 K(m) = K'(m)
    upper half plane           z = sn(w; m)                            corners at -1/k, -1, 1, 1/k;  k^2 = m
    disc (X, Y) mm             X + i Y = i R (z - i/sqrt(k)) / (z + i/sqrt(k))

The square's middle is the disc's; the middle of its right side lies at angle 0, its lower left corner at an angle of
-135 degrees. A plane layer's conductivity is the same on either side of a conformal map: what changes is length, by the
``scale`` alone, and so only what a contact or an area is. The upper half is the lower one's mirror image, which keeps
sn away from its pole (Abramowitz and Stegun, 16.21, 17.4).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import ellipj, ellipk, ellipkinc

from eitskin_sim.arrays import Array

Complex = npt.NDArray[np.complex128]

M: Final = float(np.sqrt(2.0) - 1.0) ** 4
"""m of a square."""

K: Final = float(ellipk(M))
"""Half of the square's side in w."""

MIDDLE: Final = complex(0.0, M**-0.25)
"""Of the square, in the half plane."""


@dataclass(frozen=True, slots=True)
class DiscMap:
    """A square and the disc that it is mapped onto.

    Args:
        side_mm: Of the square.
        radius_mm: Of the disc.
    """

    side_mm: float
    radius_mm: float

    def to_disc(self, xy_mm: npt.ArrayLike) -> Array:
        """Return the (n, 2) mm in the disc, from its middle, of points (n, 2) of the square."""
        lower, z, _ = self._plane(np.asarray(xy_mm, dtype=np.float64))
        disc = 1j * (z - MIDDLE) / (z + MIDDLE)
        return self.radius_mm * np.stack([disc.real, np.where(lower, disc.imag, -disc.imag)], axis=-1)

    def scale(self, xy_mm: npt.ArrayLike) -> Array:
        """Return the (n,) mm of the disc per mm of the square at its points (n, 2); 0 in the corners."""
        _, z, slope = self._plane(np.asarray(xy_mm, dtype=np.float64))
        rate = 2.0 * abs(MIDDLE) * np.abs(slope) / np.abs(z + MIDDLE) ** 2
        return np.asarray(self.radius_mm * rate * 2.0 * K / self.side_mm)

    def turn(self, xy_mm: npt.ArrayLike) -> Array:
        """Return the (n,) angles in rad by which the map turns directions at the square's points (n, 2)."""
        lower, z, slope = self._plane(np.asarray(xy_mm, dtype=np.float64))
        angle = np.angle(1j * MIDDLE * slope / (z + MIDDLE) ** 2)
        return np.asarray(np.where(lower, angle, -angle))

    def rim_to_arc_mm(self, angle_deg: npt.ArrayLike) -> Array:
        """Return the (n,) mm along the square's border, from its corner (0, 0), where angles (n,) of the rim lie."""
        turn = np.remainder(np.asarray(angle_deg, dtype=np.float64) + 180.0, 360.0) - 180.0
        lower, side = turn <= 0.0, self.side_mm
        z = np.tan(np.deg2rad(90.0 - np.abs(turn)) / 2.0) / M**0.25  # real on the rim
        size = np.abs(z)
        x = (np.copysign(ellipkinc(np.arcsin(np.minimum(size, 1.0)), M), z) / K + 1.0) * side / 2.0
        rise = np.sqrt(np.clip((1.0 - 1.0 / np.maximum(size, 1.0) ** 2) / (1.0 - M), 0.0, 1.0))
        y = ellipkinc(np.arcsin(rise), 1.0 - M) / K * side / 2.0
        y = np.where(lower, y, side - y)
        low_side = np.where(z > 0.0, side + y, 4.0 * side - y)  # up the right side, down the left one
        arc = np.where(size <= 1.0, np.where(lower, x, 3.0 * side - x), low_side)
        return np.asarray(np.remainder(arc, 4.0 * side))

    def _plane(self, xy_mm: Array) -> tuple[npt.NDArray[np.bool_], Complex, Complex]:
        """Whether points (n, 2) lie in the lower half, z there or at their mirror image, and dz/dw."""
        side = self.side_mm
        lower = xy_mm[:, 1] <= side / 2
        s, c, d, _ = ellipj(K * (2.0 * xy_mm[:, 0] / side - 1.0), M)
        s1, c1, d1, _ = ellipj(2.0 * K * np.where(lower, xy_mm[:, 1], side - xy_mm[:, 1]) / side, 1.0 - M)
        below = c1**2 + M * (s * s1) ** 2
        sn: Complex = np.asarray(s * d1 + 1j * c * d * s1 * c1, dtype=np.complex128) / below
        cn: Complex = np.asarray(c * c1 - 1j * s * d * s1 * d1, dtype=np.complex128) / below
        dn: Complex = np.asarray(d * c1 * d1 - 1j * M * s * c * s1, dtype=np.complex128) / below
        return lower, sn, cn * dn
