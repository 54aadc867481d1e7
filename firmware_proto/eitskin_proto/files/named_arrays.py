"""What the named arrays of a file must be: finite numbers of a shape, or one text; messages name array and place."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Arrays = Mapping[str, npt.NDArray[Any]]


def numbers(arrays: Arrays, name: str, shape: Sequence[int | None] | None = None) -> Array:
    """Return an array of finite numbers as float64.

    Args:
        arrays: Of a file.
        name: Of one that is there.
        shape: None in it is any length; None in its place is any shape.

    Raises:
        ValueError: It holds something else, or has another shape.
    """
    found = arrays[name]
    if found.dtype.kind not in "fiu":
        raise ValueError(f"{name} holds {found.dtype}, expected real numbers")
    if shape is not None and not _fits(found.shape, shape):
        raise ValueError(f"{name} has shape {found.shape}, expected {_told(shape)}")
    finite = np.isfinite(found)
    if not finite.all():
        where = tuple(int(one) for one in np.argwhere(~finite)[0])
        raise ValueError(
            f"{name}{list(where)} is {found[where]}, expected finite numbers; {int((~finite).sum())} are not: leave "
            "such samples out"
        )
    return np.asarray(found, dtype=np.float64)


def text(arrays: Arrays, name: str) -> str:
    """Return the text of an array that holds one, as str or as UTF-8.

    Raises:
        ValueError: It holds something else.
    """
    found = arrays[name]
    if found.dtype.kind not in "US" or found.size != 1:
        raise ValueError(f"{name} is {found.dtype} of shape {found.shape}, expected one text")
    one = found.reshape(-1)[0]
    return one.decode("utf-8") if isinstance(one, bytes) else str(one)


def _fits(found: Sequence[int], shape: Sequence[int | None]) -> bool:
    return len(found) == len(shape) and all(want in (None, have) for have, want in zip(found, shape, strict=True))


def _told(shape: Sequence[int | None]) -> str:
    return "(" + ", ".join("n" if one is None else str(one) for one in shape) + ("," if len(shape) == 1 else "") + ")"
