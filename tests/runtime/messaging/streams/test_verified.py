"""The verified message: its bytes, and that a subscriber believes nothing."""

import dataclasses

import msgpack
import pytest

from eitskin.errors import FrameError
from eitskin.messaging.streams.verified import (
    FIRST_BYTE,
    TOPIC,
    UNKNOWABLE,
    VerifiedTouch,
    asked_for,
    pack_head,
    pack_verdict,
    unpack_verified,
)

TOUCH = VerifiedTouch(
    shape="rectangle", unit=None, centre_mm=(40.0, 30.0), centre_error_mm=(0.1, 0.2), size_mm=(12.0, 10.0),
    size_error_mm=(0.3, 0.4), angle_rad=0.5, area_mm2=120.0, area_error_mm2=4.0, contrast=50.0, strength_mm2=469.0,
    strength_error_mm2=8.0, border_mm=0.0, place_mm=(40.0, 30.0, 5.0), normal=(0.0, 0.0, 1.0), angle_error_rad=0.02,
    area_range_mm2=(60.0, 140.0), contrast_range=(20.0, 90.0), size_contrast_correlation=-0.98,
)  # fmt: skip
UNIT = dataclasses.replace(TOUCH, shape="unit", unit=63, **dict.fromkeys(UNKNOWABLE))
COUNTS = {"checked": 5, "flagged": 1, "skipped": 2}
HEAD = pack_head(9, "abcd1234", COUNTS)
MESSAGE = HEAD + pack_verdict(7, 5000, 2, "ready", "", (10, 20, 30, 40_030), (104.5, 104, 0.47, False), (TOUCH, UNIT))


def altered(**fields):
    return msgpack.packb({**msgpack.unpackb(MESSAGE), **fields})


def test_a_verdict_comes_back_as_it_was():
    found = unpack_verified(MESSAGE, 50)
    assert (found.sequence, found.number, found.run, found.cloud, found.device_us) == (7, 9, "abcd1234", 2, 5000)
    assert (found.chi_squared, found.degrees_of_freedom, found.p_value, found.flagged) == (104.5, 104, 0.47, False)
    assert found.touches == (TOUCH, UNIT)
    assert found.verified
    assert found.trusted
    assert found.spent_s == pytest.approx(40e-6)
    assert (dict(found.counts), found.received_ns, found.frame) == (COUNTS, 50, None)


def test_a_flagged_verdict_says_why():
    told = pack_verdict(7, 5000, 2, "ready", "contested", (10, 20, 30, 40), (104.5, 104, 0.046, True), (TOUCH,))
    found = unpack_verified(HEAD + told)
    assert (found.flagged, found.why, found.trusted) == (True, "contested", False)


def test_its_first_bytes_are_constant_and_select_it():
    assert MESSAGE.startswith(TOPIC)
    assert TOPIC == b"\x8f\xa8verified"
    assert len(msgpack.unpackb(MESSAGE)) == 15
    assert asked_for(TOPIC)
    assert asked_for(FIRST_BYTE)
    assert not any(map(asked_for, (b"", b"\xde", b"\xdf", b"\x86", b"\x8f\xa9", b"eitskin/touches")))


@pytest.mark.parametrize("name", sorted(msgpack.unpackb(MESSAGE)))
@pytest.mark.parametrize("value", ["x" * 999, [1], {"a": 1}, b"x", float("nan")])
def test_a_field_of_another_kind_is_refused(name, value):
    with pytest.raises(FrameError):
        unpack_verified(altered(**{name: value}))


@pytest.mark.parametrize("message", [b"", b"\x8f", MESSAGE[:-3], b"\xc1" * 20, msgpack.packb([1, 2])])
def test_what_is_no_message_is_refused(message):
    with pytest.raises(FrameError):
        unpack_verified(message)


def test_another_version_and_an_impossible_p_are_refused():
    with pytest.raises(FrameError, match="expected 4"):
        unpack_verified(altered(v=5))
    with pytest.raises(FrameError, match="0 to 1"):
        unpack_verified(altered(p_value=1.5))
    with pytest.raises(FrameError, match="one of starting"):
        unpack_verified(altered(state="asleep"))
