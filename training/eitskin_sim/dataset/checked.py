"""What a data set's files hold, looked at before it is believed."""

from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.plain import quoted
from eitskin_sim.scene.parts import Bend


def array_of(values: npt.NDArray[Any], kind: str, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """Return an array that has a kind and a shape, of which None leaves a size open; floats are finite.

    Raises:
        ValueError: It has others, or a number is not finite.
    """
    fits = len(values.shape) == len(shape) and all(
        wanted in (None, size) for wanted, size in zip(shape, values.shape, strict=True)
    )
    if values.dtype.kind != kind or not fits:
        raise ValueError(f"an array is {values.dtype} {values.shape}, expected kind {kind} of shape {shape}")
    if kind == "f" and not np.isfinite(values).all():
        raise ValueError("an array holds numbers that are not finite")
    return values


def bend_from_json(value: dict[str, Any]) -> Bend:
    """Return the bend that ``dataclasses.asdict`` made JSON of.

    Raises:
        ValueError: A number is none, or not finite.
        TypeError: A key is unknown.
    """
    for name, number in value.items():
        if name != "bumps_mm" and (
            isinstance(number, bool) or not isinstance(number, int | float) or not abs(number) < 1e9
        ):
            raise ValueError(f"a bend's {quoted(name)} is {quoted(number)}, expected a finite number")
    bumps = tuple((float(x), float(y), float(height), float(sigma)) for x, y, height, sigma in value["bumps_mm"])
    return Bend(**{**value, "bumps_mm": bumps})
