"""What comes from outside is read by kind and bound, and refused in one line that says where, found and expected."""

import math

import numpy as np
import pytest

from eitskin_proto.fields import Fields


class WrongError(Exception):
    """What the reader under test raises."""


def fields(**content):
    return Fields(content, "scene", error=WrongError, joint=".")


def test_what_fits_is_returned_and_what_is_missing_has_its_default():
    found = fields(
        truth=True, number=3, whole=4, text="name", choice="lower", table={"a": 1}, entries=[{"b": 2}],
        numbers=[1, 2.5],
        wholes=[1, 2], texts=["x"], raw=b"ab", array=np.arange(3, dtype="<f4").tobytes(), nil=None,
    )  # fmt: skip
    assert (found.truth("truth"), found.number("number"), found.whole("whole")) == (True, 3.0, 4)
    assert (found.text("text"), found.choice("choice", ("lower", "raise"))) == ("name", "lower")
    assert found.table("table").whole("a") == found.entries("entries").table(0).whole("b") - 1
    assert (found.numbers("numbers", 2), found.wholes("wholes"), found.texts("texts")) == ((1.0, 2.5), (1, 2), ("x",))
    assert (found.raw("raw", most=2), found.array("array", "<f4", (3,)).tolist()) == (b"ab", [0.0, 1.0, 2.0])
    assert found.is_nil("nil")
    found.close()
    empty = fields()
    assert empty.number("a", None) is empty.text("b", None) is empty.truth("c", None) is None
    assert (empty.whole("d", 5), empty.wholes("e", ()), len(empty.table("f")), len(empty.entries("g"))) == (5, (), 0, 0)


@pytest.mark.parametrize(
    ("value", "read", "line"),
    [
        (math.nan, lambda f: f.number("x"), "scene.x is nan, expected a number"),
        (10**400, lambda f: f.number("x"), "scene.x is a number of 1329 bits, expected a number"),
        (True, lambda f: f.number("x", low=0.0), "scene.x is True, expected a number of at least 0"),
        (0, lambda f: f.number("x", above=0.0), "scene.x is 0, expected a number above 0"),
        (9, lambda f: f.number("x", low=1.0, high=2.5), "scene.x is 9, expected a number from 1 to 2.5"),
        (3.0, lambda f: f.whole("x", high=99), "scene.x is 3.0, expected a whole number from 0 to 99"),
        ("a\x1b", lambda f: f.text("x", longest=9), r"scene.x is 'a\x1b', expected a text of at most 9 printable"),
        ("", lambda f: f.text("x"), "scene.x is empty, expected a text"),
        ("rise", lambda f: f.choice("x", ("lower", "raise")), "expected one of lower, raise; did you mean 'raise'?"),
        ([], lambda f: f.table("x"), "scene.x is a list of 0, expected a table"),
        ({}, lambda f: f.entries("x", of="skins"), "scene.x is an object of 0, expected a list of skins"),
        ([1], lambda f: f.entries("x", least=2, most=4), "scene.x is a list of 1, expected a list of 2 to 4 entries"),
        ([1, "2"], lambda f: f.numbers("x", 2), "scene.x[1] is '2', expected a number"),
        ([1, 16], lambda f: f.wholes("x", high=15), "scene.x[1] is 16, expected a whole number from 0 to 15"),
        (b"abc", lambda f: f.raw("x", most=2), "scene.x is 3 bytes, expected 0 to 2 bytes"),
        (b"abc", lambda f: f.array("x", "<f4", (2,)), "scene.x is 3 bytes, expected 8 bytes of <f4 (2,)"),
        (np.array([np.inf], "<f4").tobytes(), lambda f: f.array("x", "<f4", (1,)), "scene.x holds values that are not"),
        (1, lambda f: f.whole("y"), "scene lacks y, expected a whole number of at least 0"),
        (1, lambda f: f.check_format("a", 1, "a skin"), "format is None version None, expected 'a' version 1: is it a"),
    ],
)
def test_what_does_not_fit_is_one_line(value, read, line):
    with pytest.raises(WrongError) as raised:
        read(fields(x=value))
    assert line in str(raised.value)
    assert str(raised.value).isprintable()


def test_a_key_that_nobody_reads_is_refused_with_the_nearest_one():
    found = fields(width_mm=1, depth=2)
    assert found.number("width_mm") == 1.0
    with pytest.raises(WrongError, match="unknown key 'depth' in scene; known are width_mm"):
        found.close()
    with pytest.raises(WrongError, match=r"scene lacks depth_mm, expected .*; is it meant by 'depth'"):
        found.number("depth_mm")
    with pytest.raises(WrongError, match="unknown key 'depth' in scene; did you mean 'depths'"):
        found.only(["width_mm", "depths"])
    with pytest.raises(WrongError, match="the file is a list of 0, expected a table"):
        Fields([], "", error=WrongError)
