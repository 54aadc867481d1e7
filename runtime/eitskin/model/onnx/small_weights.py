"""Weights of a network that are too small to be computed with, set to 0 in its file before it is loaded.

Only matrices and what has more axes: they are multiplied with what a frame brings. A small number by itself may be the
one that a division must not lose, and a vector that is added costs the same whatever it holds. A processor's own switch
for it is no way: ONNX Runtime's ``session.set_denormal_as_zero`` turns it in the thread that makes the first session
and in every thread made there later, for good and for everything, numpy and the caller's own arithmetic included.
"""

from typing import Final

import numpy as np

from eitskin.errors import BundleError
from eitskin.model.denormals import is_small
from eitskin.model.onnx.protobuf import DATA_TYPE, FLOATS, GRAPH, INITIALISER, RAW, content, dims_of, fields_of

FLOAT32: Final = 1
"""ONNX's number for the element type."""


def without_small_weights(model: bytes) -> bytes:
    """Return the model itself, or a copy with 0 for every weight that is not computed with.

    Args:
        model: An ONNX file; one that cannot be read is returned as it is, for ONNX Runtime to say what is wrong.
    """
    if not _flush(memoryview(model)):
        return model
    changed = bytearray(model)
    _flush(memoryview(changed))
    return bytes(changed)


def _flush(model: memoryview) -> bool:
    """Return whether there are such weights, and overwrite them where the memory can be written."""
    found = False
    try:
        for field in fields_of(model):
            for inside in fields_of(content(field)) if field.number == GRAPH else ():
                if inside.number == INITIALISER:
                    found |= _flush_tensor(content(inside))
    except (BundleError, IndexError, ValueError):
        return found
    return found


def _flush_tensor(tensor: memoryview) -> bool:
    fields = list(fields_of(tensor))
    if not any(field.number == DATA_TYPE and field.value == FLOAT32 for field in fields) or len(dims_of(tensor)) < 2:
        return False
    found = False
    for field in fields:
        if field.number in (RAW, FLOATS):
            values = np.frombuffer(content(field), dtype="<f4")
            small = is_small(values)
            found |= bool(small.any())
            if values.flags.writeable:
                values[small] = 0.0
    return found
