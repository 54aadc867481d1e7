"""The pose of a skin on a robot: the rotation and translation from the skin's frame to the robot's.

::

    place in the robot's frame = rotation x place of the skin + translation_mm

The skin's own frame is that of its cloud: x, y and z as the measured points have them, and the flat sheet's, with
z = 0, where no cloud was given. Directions are rotated and not moved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from eitskin.touches.touch import Touch

Array = npt.NDArray[np.float64]

ROTATION_TOLERANCE: Final = 2e-3
"""How far from a rotation a matrix or a quaternion may be that was written with three digits."""

FARTHEST_MM: Final = 1e6
"""A kilometre: a larger number means another unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rotation and a translation from a skin's frame to the robot's frame.

    Attributes:
        rotation: (3, 3), orthonormal and right-handed; its columns are the skin's axes in the robot's frame.
        translation_mm: (3,), place of the skin's origin in the robot's frame.
    """

    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation_mm: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of(
        cls,
        *,
        rotation: Sequence[Sequence[float]] | None = None,
        quaternion_wxyz: Sequence[float] | None = None,
        translation_mm: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> Self:
        """Return a pose from plain numbers; a nearly orthonormal rotation becomes exactly one.

        Args:
            rotation: (3, 3), rows first.
            quaternion_wxyz: (4,) of length 1, the real part first. Without ``rotation`` and this, nothing rotates.
            translation_mm: (3,) mm.

        Raises:
            ValueError: Both are given, or one is not a rotation, or not finite; with the value found.
        """
        moved = _numbers(translation_mm, (3,), "translation_mm")
        if np.abs(moved).max() > FARTHEST_MM:
            raise ValueError(f"translation_mm is up to {np.abs(moved).max():g}, expected mm of at most {FARTHEST_MM:g}")
        if rotation is not None and quaternion_wxyz is not None:
            raise ValueError("found both rotation and quaternion, expected one of them")
        turned = np.eye(3)
        if quaternion_wxyz is not None:
            turned = _of_quaternion(_numbers(quaternion_wxyz, (4,), "quaternion"))
        elif rotation is not None:
            turned = _nearest(_numbers(rotation, (3, 3), "rotation"))
        for values in (turned, moved):
            values.flags.writeable = False
        return cls(turned, moved)

    def place(self, places_mm: npt.ArrayLike) -> Array:
        """Return places in the robot's frame.

        Args:
            places_mm: (..., 3) in the skin's frame.
        """
        return np.asarray(np.asarray(places_mm, dtype=np.float64) @ self.rotation.T + self.translation_mm)

    def direction(self, directions: npt.ArrayLike) -> Array:
        """Return directions in the robot's frame.

        Args:
            directions: (..., 3) in the skin's frame, such as normals.
        """
        return np.asarray(np.asarray(directions, dtype=np.float64) @ self.rotation.T)

    def touch(self, touch: Touch) -> Touch:
        """Return the touch with place and normal in the robot's frame."""
        x, y, z = self.place(touch.place_mm).tolist()
        nx, ny, nz = self.direction(touch.normal).tolist()
        return replace(touch, place_mm=(x, y, z), normal=(nx, ny, nz))

    def fields(self) -> dict[str, object]:
        """Return the pose as plain lists, the arguments of :meth:`of`."""
        return {"rotation": self.rotation.tolist(), "translation_mm": self.translation_mm.tolist()}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Pose):
            return NotImplemented
        return self.fields() == other.fields()

    def __hash__(self) -> int:
        return hash(self.rotation.tobytes() + self.translation_mm.tobytes())

    def __str__(self) -> str:
        """Return one line: the origin and the skin's axes."""
        x, y, z = self.translation_mm.tolist()
        axes = ", ".join(
            f"{name} {column.round(3).tolist()}" for name, column in zip("xyz", self.rotation.T, strict=True)
        )
        return f"at {x:g} {y:g} {z:g} mm, axes {axes}"


def _numbers(values: object, shape: tuple[int, ...], name: str) -> Array:
    expected = f"{name}: expected {' x '.join(map(str, shape))} finite numbers"
    try:
        found = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{expected}, found something else") from None
    if found.shape != shape:
        raise ValueError(f"{expected}, found {' x '.join(map(str, found.shape)) or 'one'}")
    if not np.isfinite(found).all():
        raise ValueError(f"{expected}, found one that is not")
    return found


def _of_quaternion(values: Array) -> Array:
    length = float(np.sqrt(values @ values))
    if abs(length - 1.0) > ROTATION_TOLERANCE:
        raise ValueError(f"quaternion has the length {length:.4g}, expected 1: it is not a rotation")
    w, x, y, z = (values / length).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _nearest(matrix: Array) -> Array:
    """Return the rotation nearest to a matrix that nearly is one."""
    if np.abs(matrix).max() > 1.0 + ROTATION_TOLERANCE:
        raise ValueError(f"rotation has an entry of {np.abs(matrix).max():g}, expected -1 to 1: it is not a rotation")
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > ROTATION_TOLERANCE:
        raise ValueError(
            f"rotation times its transpose is off the unit matrix by {off:.3g}, expected at most "
            f"{ROTATION_TOLERANCE:g}: it is not a rotation"
        )
    if np.linalg.det(matrix) < 0.0:
        raise ValueError("rotation has the determinant -1, expected +1: it is a mirror, and no rotation")
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)
