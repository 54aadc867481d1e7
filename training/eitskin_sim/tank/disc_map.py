"""The conformal map between a rectangle and a disc, by Jacobi's elliptic functions.

::

    rectangle (x, y) mm        w = K (2 x / L - 1) + i K' y / W        2 K(m) / K'(m) = L / W
    upper half plane           z = sn(w; m)                            corners at -1/k, -1, 1, 1/k;  k^2 = m
    disc (X, Y) mm             X + i Y = i R (z - i/sqrt(k)) / (z + i/sqrt(k))

The rectangle's middle is the disc's; the middle of its right side lies at angle 0, a square's lower left corner at an
angle of -135 degrees. A plane layer's conductivity is the same on either side of a conformal map: what changes is
length, by the ``scale`` alone, and so only what a contact or an area is. The upper half is the lower one's mirror
image, which keeps sn away from its pole (Abramowitz and Stegun, 16.21, 17.4).
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.special import ellipj, ellipk, ellipkinc, ellipkm1

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

MAX_ASPECT: Final = 4.0
"""Of the rectangle, either way: beyond it the corners crowd on the rim."""


@dataclass(frozen=True, slots=True)
class DiscMap:
    """A rectangle and the disc that it is mapped onto.

    Args:
        size_mm: Length and width of the rectangle.
        radius_mm: Of the disc.

    Raises:
        ValueError: A length is not positive, or the rectangle longer than ``MAX_ASPECT`` times its width.
    """

    size_mm: tuple[float, float]
    radius_mm: float
    modulus: float = field(init=False)
    """m."""

    def __post_init__(self) -> None:
        length, width = self.size_mm
        if not (length > 0.0 and width > 0.0 and self.radius_mm > 0.0):
            raise ValueError(f"sides {length:g} x {width:g} mm and radius {self.radius_mm:g} mm must be above 0")
        if not 1.0 / MAX_ASPECT <= length / width <= MAX_ASPECT:
            raise ValueError(
                f"a rectangle of {length:g} x {width:g} mm: one side must be at most {MAX_ASPECT:g} others"
            )

        def excess(logit: float) -> float:
            m = 1.0 / (1.0 + np.exp(-logit))
            return float(np.log(2.0 * ellipk(m) / ellipkm1(m)) - np.log(length / width))

        logit = brentq(excess, -60.0, 30.0, xtol=1e-14, rtol=1e-15)
        object.__setattr__(self, "modulus", float(1.0 / (1.0 + np.exp(-logit))))

    def to_disc(self, xy_mm: npt.ArrayLike) -> Array:
        """Return the (n, 2) mm in the disc, from its middle, of points (n, 2) of the rectangle."""
        lower, z, _ = self._plane(np.asarray(xy_mm, dtype=np.float64))
        disc = 1j * (z - self._middle) / (z + self._middle)
        return self.radius_mm * np.stack([disc.real, np.where(lower, disc.imag, -disc.imag)], axis=-1)

    def scale(self, xy_mm: npt.ArrayLike) -> Array:
        """Return the (n,) mm of the disc per mm of the rectangle at its points (n, 2); 0 in the corners."""
        _, z, slope = self._plane(np.asarray(xy_mm, dtype=np.float64))
        rate = 2.0 * abs(self._middle) * np.abs(slope) / np.abs(z + self._middle) ** 2
        return np.asarray(self.radius_mm * rate * 2.0 * ellipk(self.modulus) / self.size_mm[0])

    def turn(self, xy_mm: npt.ArrayLike) -> Array:
        """Return the (n,) angles in rad by which the map turns directions at the rectangle's points (n, 2)."""
        lower, z, slope = self._plane(np.asarray(xy_mm, dtype=np.float64))
        angle = np.angle(1j * self._middle * slope / (z + self._middle) ** 2)
        return np.asarray(np.where(lower, angle, -angle))

    def rim_to_arc_mm(self, angle_deg: npt.ArrayLike) -> Array:
        """Return the (n,) mm along the rectangle's border, from its corner (0, 0), where angles (n,) of the rim lie."""
        turn = np.remainder(np.asarray(angle_deg, dtype=np.float64) + 180.0, 360.0) - 180.0
        lower = turn <= 0.0
        z = np.tan(np.deg2rad(90.0 - np.abs(turn)) / 2.0) / self.modulus**0.25  # real on the rim
        m, size = self.modulus, np.abs(z)
        along = ellipkinc(np.arcsin(np.minimum(size, 1.0)), m)
        rise = np.sqrt(np.clip((1.0 - 1.0 / np.maximum(size, 1.0) ** 2) / (1.0 - m), 0.0, 1.0))
        w = np.copysign(along, z) + 1j * ellipkinc(np.arcsin(rise), 1.0 - m)
        x, y = self._millimetres(w, lower).T
        length, width = self.size_mm
        low_side = np.where(z > 0.0, length + y, 2.0 * (length + width) - y)  # up the right side, down the left one
        inner = size <= 1.0
        arc = np.where(inner, np.where(lower, x, 2.0 * length + width - x), low_side)
        return np.asarray(np.remainder(arc, 2.0 * (length + width)))

    @property
    def _middle(self) -> complex:
        """Of the rectangle, in the half plane."""
        return complex(0.0, self.modulus**-0.25)

    def _plane(self, xy_mm: Array) -> tuple[npt.NDArray[np.bool_], Complex, Complex]:
        """Whether points (n, 2) lie in the lower half, z there or at their mirror image, and dz/dw."""
        (length, width), m = self.size_mm, self.modulus
        lower = xy_mm[:, 1] <= width / 2
        u = ellipk(m) * (2.0 * xy_mm[:, 0] / length - 1.0)
        v = ellipkm1(m) * np.where(lower, xy_mm[:, 1], width - xy_mm[:, 1]) / width
        s, c, d, _ = ellipj(u, m)
        s1, c1, d1, _ = ellipj(v, 1.0 - m)
        below = c1**2 + m * (s * s1) ** 2
        sn: Complex = np.asarray(s * d1 + 1j * c * d * s1 * c1, dtype=np.complex128) / below
        cn: Complex = np.asarray(c * c1 - 1j * s * d * s1 * d1, dtype=np.complex128) / below
        dn: Complex = np.asarray(d * c1 * d1 - 1j * m * s * c * s1, dtype=np.complex128) / below
        return lower, sn, cn * dn

    def _millimetres(self, w: Complex, lower: npt.NDArray[np.bool_]) -> Array:
        length, width = self.size_mm
        x = (w.real / ellipk(self.modulus) + 1.0) * length / 2
        y = w.imag / ellipkm1(self.modulus) * width
        return np.stack([x, np.where(lower, y, width - y)], axis=-1)
