"""No number that is slow to compute reaches the arithmetic, whatever a cloud, a prediction or a bundle holds."""

import numpy as np
import pytest

from eitskin.errors import BundleError
from eitskin.model.denormals import SMALLEST, flushed
from eitskin.model.onnx_graph import GRAPH, INITIALISER, RAW, check_graph, fields_of

DENORMAL = np.float32(1e-40)


def test_what_is_too_small_becomes_0_and_nothing_else_changes():
    values = np.array([1.0, -DENORMAL, 0.0, SMALLEST / 2, SMALLEST, -1e-16, np.nan, np.inf], dtype=np.float32)
    expected = np.array([1.0, 0.0, 0.0, 0.0, SMALLEST, -1e-16, np.nan, np.inf], dtype=np.float32)
    found = flushed(values)
    assert np.array_equal(found, expected, equal_nan=True)
    assert found.dtype == np.float32
    assert values[1] == -DENORMAL
    assert flushed(found) is found


def with_tiny_weights(model):
    """Return a model of which the first weight of every initialiser's data is a denormal."""
    changed = bytearray(model)
    for graph in fields_of(memoryview(changed))[GRAPH]:
        for constant in fields_of(graph)[INITIALISER]:
            for part in fields_of(constant).get(RAW, ()):
                if len(part) >= 4 * 75:
                    part[:4] = DENORMAL.tobytes()
    return bytes(changed)


def test_a_network_with_denormal_weights_is_refused(tiny):
    check_graph(tiny.files["head.onnx"])
    with pytest.raises(BundleError, match=r"constant .* holds numbers below 1e-20, expected 0"):
        check_graph(with_tiny_weights(tiny.files["head.onnx"]))
