"""A touch as physics has found it: where, how large, how strong, how sure."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, Self

from eitskin.errors import FrameError

SHAPES: Final = ("unit", "rectangle", "ellipse")
"""Of touches."""

PAIRS: Final = ("centre_mm", "centre_error_mm", "size_mm", "size_error_mm", "area_range_mm2", "contrast_range")
THREES: Final = ("place_mm", "normal")
NUMBERS: Final = (
    "angle_rad", "area_mm2", "area_error_mm2", "contrast", "strength_mm2", "strength_error_mm2", "border_mm",
    "angle_error_rad", "size_contrast_correlation",
)  # fmt: skip
ADDED: Final = ("angle_error_rad", "area_range_mm2", "contrast_range", "size_contrast_correlation")
"""Left out of a message where they are not told, and by releases that did not know them."""

UNKNOWABLE: Final = ("centre_error_mm", "size_error_mm", "area_error_mm2", "strength_error_mm2", *ADDED)
"""None where a verifier does not tell them."""


@dataclass(frozen=True, slots=True)
class VerifiedTouch:
    """One touch of a verified frame.

    Attributes:
        shape: ``unit``: a touch unit of the sheet, as bundle ``units`` knows them; ``rectangle`` or ``ellipse``.
        unit: Number of the unit, row by row; None for other shapes.
        centre_mm: x and y on the flat sheet.
        centre_error_mm: Its standard errors; None for a unit, which is where it is.
        size_mm: Length and width.
        size_error_mm: Their standard errors; None for a unit.
        angle_rad: Of the length against x, towards y; from 0 to below pi.
        area_mm2: On the flat sheet.
        area_error_mm2: Its standard error; None for a unit.
        contrast: Conductivity over the untouched sheet's.
        strength_mm2: Logarithm of the contrast times the area; below 0 where a press lowers conductance.
        strength_error_mm2: Its standard error; None for a unit: its area is known, and its contrast is the usual one
            unless another explains the frame far better, so a fit has no error to tell.
        border_mm: Width of the graded border; 0 is sharp.
        place_mm: x, y and z of the centre on the surface in use, in the pose in which its cloud was given.
        normal: The unit vector in which the surface faces there; zeros where it has no direction.
        angle_error_rad: Standard error of the angle; None for a unit, and where the angle was not fitted.
        area_range_mm2: How far the area may go, the contrast going along; None for a unit. A small touch of high
            contrast and a larger one of lower contrast read nearly alike.
        contrast_range: How far the contrast may go, the area going along; None for a unit.
        size_contrast_correlation: Of the logarithms of both, from -1 to 1: near -1 only their product, the strength, is
            known; None for a unit.
    """

    shape: str
    unit: int | None
    centre_mm: tuple[float, float]
    centre_error_mm: tuple[float, float] | None
    size_mm: tuple[float, float]
    size_error_mm: tuple[float, float] | None
    angle_rad: float
    area_mm2: float
    area_error_mm2: float | None
    contrast: float
    strength_mm2: float
    strength_error_mm2: float | None
    border_mm: float
    place_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    angle_error_rad: float | None = None
    area_range_mm2: tuple[float, float] | None = None
    contrast_range: tuple[float, float] | None = None
    size_contrast_correlation: float | None = None

    def fields(self) -> dict[str, Any]:
        """Return the touch as a message's map."""
        return {name: value for name, value in asdict(self).items() if value is not None or name not in ADDED}

    def __str__(self) -> str:
        """Return it in a line, for people."""
        x, y = self.centre_mm
        which = self.shape if self.unit is None else f"unit {self.unit}"
        off = "" if self.centre_error_mm is None else f" +- {max(self.centre_error_mm):.2f}"
        length, width = self.size_mm
        area = "" if self.area_range_mm2 is None else "area {:.0f} to {:.0f} mm2, ".format(*self.area_range_mm2)
        error = "" if self.strength_error_mm2 is None else f" +- {self.strength_error_mm2:.0f}"
        return (
            f"{which} at x {x:.1f}, y {y:.1f}{off} mm, {length:.1f} x {width:.1f} mm, {area}"
            f"contrast {self.contrast:.3g}, strength {self.strength_mm2:.0f}{error} mm2"
        )

    @classmethod
    def of(cls, found: object) -> Self:
        """Return the touch of a message's map.

        Raises:
            FrameError: It is malformed.
        """
        if not isinstance(found, dict) or found.get("shape") not in SHAPES:
            raise FrameError(f"verified touch: found {str(found)[:40]}, expected a map with a shape")
        unit = found.get("unit")
        if unit is not None and (type(unit) is not int or unit < 0):
            raise FrameError(f"verified touch, unit: found {str(unit)[:40]}, expected a count or nil")
        fields: dict[str, Any] = {name: _numbers(found, name, 2) for name in PAIRS}
        fields |= {name: _numbers(found, name, 3) for name in THREES}
        fields |= {name: _number(found, name) for name in NUMBERS}
        return cls(shape=found["shape"], unit=unit, **fields)


def _number(found: Mapping[str, Any], name: str) -> float | None:
    value = found.get(name)
    if value is None and name in UNKNOWABLE:
        return None
    if not isinstance(value, float) or not math.isfinite(value):
        raise FrameError(f"verified touch, {name}: found {str(value)[:40]}, expected a finite float")
    return value


def _numbers(found: Mapping[str, Any], name: str, count: int) -> tuple[float, ...] | None:
    values = found.get(name)
    if values is None and name in UNKNOWABLE:
        return None
    if (
        not isinstance(values, list)
        or len(values) != count
        or not all(isinstance(value, float) and math.isfinite(value) for value in values)
    ):
        raise FrameError(f"verified touch, {name}: found {str(values)[:40]}, expected {count} finite floats")
    return tuple(values)
