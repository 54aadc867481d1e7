"""Named arrays of a file: what is wrong is said with the array's name and the place in it."""

import numpy as np
import pytest

from eitskin_proto.files.arrays import numbers, text


@pytest.mark.parametrize("given", [np.ones((2, 3), np.float32), np.ones((2, 3), int), np.ones((2, 3), np.uint8)])
def test_numbers_of_any_kind_become_float64(given):
    found = numbers({"a": given}, "a", (None, 3))
    assert found.dtype == np.float64
    assert (found == given).all()


@pytest.mark.parametrize(
    ("given", "shape", "message"),
    [
        (np.ones(3, complex), None, "a holds complex128, expected real numbers"),
        (np.array(["x"]), None, "a holds <U1, expected real numbers"),
        (np.array([True]), None, "a holds bool, expected real numbers"),
        (np.ones((2, 3)), (None, 4), r"a has shape \(2, 3\), expected \(n, 4\)"),
        (np.ones(3), (4,), r"a has shape \(3,\), expected \(4,\)"),
        (np.ones(3), (3, 1), r"a has shape \(3,\), expected \(3, 1\)"),
        (np.array([[1.0, 2.0], [np.nan, np.inf]]), None, r"a\[1, 0\] is nan, expected finite numbers; 2 are not"),
        (np.array(np.inf), (), r"a\[\] is inf"),
    ],
)
def test_what_is_no_such_array_is_named(given, shape, message):
    with pytest.raises(ValueError, match=message):
        numbers({"a": given}, "a", shape)


@pytest.mark.parametrize("given", [np.array("grün"), np.array(["grün"]), np.array("grün".encode())])
def test_a_text_is_taken_as_it_was_saved(given):
    assert text({"a": given}, "a") == "grün"


@pytest.mark.parametrize("given", [np.array(7), np.array(["a", "b"]), np.array([], "U1")])
def test_what_is_no_single_text_is_named(given):
    with pytest.raises(ValueError, match=r"a is .* of shape \(.*\), expected one text"):
        text({"a": given}, "a")
