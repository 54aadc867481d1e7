import numpy as np
import pytest

from eitskin_proto.wire.framing import Deframer
from eitskin_tools.bench.peer import (
    MARKER,
    PAYLOAD_BYTES,
    ages,
    corruption,
    flipped,
    number_of,
    on_the_wire,
    ours,
    payload,
)


def test_both_formats_carry_the_same_payload() -> None:
    for number in (0, 7, 12_345):
        contents = payload(number)
        assert len(contents) == PAYLOAD_BYTES
        assert max(contents) < MARKER[0]
        assert number_of(contents) == number
        assert on_the_wire(number, "flexitac") == MARKER + contents
        assert Deframer().feed(b"\0" + on_the_wire(number, "eitskin")) == [contents]


def test_a_flipped_frame_differs_in_one_bit() -> None:
    frame = on_the_wire(3, "eitskin")
    changed = np.frombuffer(frame, np.uint8) ^ np.frombuffer(flipped(frame, 3), np.uint8)
    assert int(np.unpackbits(changed).sum()) == 1


@pytest.mark.process
def test_our_reader_returns_every_whole_frame_and_no_damaged_one() -> None:
    found = ages(ours(), 100, 200.0)
    assert found["returned"] == found["sent"]
    assert found["sent"] + found["dropped_by_full_line"] == 100
    assert found["age_us_p50"] > 0
    assert corruption(ours(), 60, 200.0)["corrupt_accepted"] == 0
