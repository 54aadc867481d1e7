"""Learns to tell the shapes of a sheet apart: by the levels of its untouched rows, whatever presses and drift do.

Linear discriminant analysis: the shape of a reading is the one whose level is nearest, where presses, drift and noise
have unit variance.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from eitskin.model.bundle import MOST_SHAPES
from eitskin_proto.files.arrays import Array
from eitskin_tools.teach.presses import Presses, PressesError
from eitskin_tools.teach.response import shrunk


def check_shapes(shapes: Mapping[str, Presses]) -> None:
    """Refuse files of presses that are not of one sheet in several shapes.

    Raises:
        PressesError: They are too many, of different sheets or rows, or have changes alone.
    """
    if len(shapes) > MOST_SHAPES:
        raise PressesError(f"found {len(shapes)} files, expected at most {MOST_SHAPES}, one for each shape")
    (first, expected), *others = shapes.items()
    for name, one in others:
        if one.is_change or expected.is_change:
            raise PressesError(f"{name if one.is_change else first} has no untouched reading: give voltages_V")
        if (one.sheet, one.table.id) != (expected.sheet, expected.table.id):
            raise PressesError(f"{name} has {one.sheet}, expected {expected.sheet} and the same rows, as {first} has")


def level_arrays(shapes: Sequence[Presses], taught: Sequence[Mapping[str, Array]]) -> list[dict[str, Array]]:
    """Return level of each shape and, with the first, white (:class:`eitskin.model.taught.TaughtField`).

    Args:
        shapes: Presses in each.
        taught: The other arrays of each.
    """
    if any(one.is_change for one in shapes):
        return [{} for _ in shapes]
    levels = [one.levels().mean(axis=0) for one in shapes]
    presses = np.concatenate([one.logarithms()[one.pressed] for one in shapes])
    drift = np.concatenate([one.levels() - level for one, level in zip(shapes, levels, strict=True)])
    fields = np.concatenate([(one["field"] @ np.linalg.pinv(one["project"]))[one["inside"]] for one in taught])
    anywhere = fields.T @ fields / len(fields)  # some places were not pressed
    values, vectors = np.linalg.eigh(shrunk(presses) + anywhere + shrunk(drift))
    white = vectors / np.sqrt(np.maximum(values, values[-1] * 1e-9))
    found = [{"level": level} for level in levels]
    found[0]["white"] = white.astype(np.float32)
    return found
