import contextlib
import math
import struct

import msgpack
import numpy as np
import pytest

from eitskin.errors import FrameError
from eitskin.frame_record import STAGES
from eitskin.messaging.frame import COUNTS, NUMBERS, TOUCHED, unpack_frame
from eitskin.messaging.frame_message import FramePacker
from eitskin_proto.skin.skin import PAPER


@pytest.fixture
def packer():
    return FramePacker(
        configuration="paper/0000abcd",
        bundle="0123456789abcdef",
        serial_number="S-1",
        run="cafe0001",
        shape=PAPER.grid.shape,
    )


def filled(packer, **numbers):
    values = {"n": 3, "seq": 7, "device_us": 2**33, "age_us": 400, "gate_logit": -1.5, "cloud": 2}
    values |= {"weak_rows": 1, "map_seq": 7, "fused": 16}
    values |= {name: 10 + index for index, name in enumerate(COUNTS)}
    values |= {name: 1000 * (index + 1) for index, name in enumerate(STAGES)}
    values |= {"touched": TOUCHED[True], "drift": math.nan, "drift_sd": math.nan, "drift_uneven": math.nan} | numbers
    packer.put_numbers(tuple(values[name] for name in NUMBERS))
    packer.put_map(np.linspace(0, 1, 1350, dtype="<f4").tobytes())
    packer.put_texts("vd2t", ("geometry:cloud_unchanged",), ("lost", "overrun"))
    return bytes(packer.message())


def test_a_packed_frame_comes_back_field_by_field(packer):
    frame = unpack_frame(filled(packer), received_ns=9000)
    assert np.array_equal(frame.map, np.linspace(0, 1, 1350, dtype=np.float32).reshape(30, 45))
    assert (frame.sequence, frame.number, frame.device_us, frame.age_us) == (7, 3, 2**33, 400)
    assert frame.touched
    assert frame.fused == 16
    assert frame.gate_logit == -1.5
    assert frame.host_ns == {name: 1000 * (index + 1) for index, name in enumerate(STAGES)}
    assert frame.counts == {"lost": 10, "corrupt": 11, "withheld": 12, "overrun": 13}
    assert (frame.solver, frame.skipped, frame.events) == ("vd2t", ("geometry:cloud_unchanged",), ("lost", "overrun"))
    assert (frame.configuration, frame.bundle, frame.cloud, frame.weak_rows) == (
        "paper/0000abcd",
        "0123456789abcdef",
        2,
        1,
    )
    assert frame.same_host
    assert frame.latency_s == pytest.approx(8000e-9)
    assert frame.stages_us() == {name: 1.0 for name in (*STAGES[1:],)} | {"deliver": 2.0}


HOSTILE = (b"\x91" * 5000, b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xdd\x7f\xff\xff\xff", bytes(20000))


def test_what_is_shortened_random_nested_or_claims_gigabytes_is_rejected(packer):
    message, rng = filled(packer), np.random.default_rng(1)
    assert unpack_frame(message, 0).sequence == 7
    ends = [*range(0, len(message), 97), *range(len(message) - 200, len(message))]
    random = [rng.integers(0, 256, size, dtype=np.uint8).tobytes() for size in rng.integers(0, 400, 2000)]
    for wrong in [*(message[:end] for end in ends), *random, *HOSTILE]:
        with pytest.raises(FrameError):
            unpack_frame(wrong, 0)


def test_no_flipped_bit_outside_the_values_raises_anything_but_frame_error(packer):
    message = filled(packer)
    head = message.index(b"\xc5" + struct.pack(">H", 5400))
    for at in [*range(head + 3), *range(len(message) - 250, len(message))]:
        for bit in range(8):
            damaged = bytearray(message)
            damaged[at] ^= 1 << bit
            with contextlib.suppress(FrameError):  # a flipped digit of a counter is still a frame
                unpack_frame(bytes(damaged), 0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("v", 2), ("shape", [45, 30]), ("map", b"\0" * 5399), ("map", "text"), ("touched", 1), ("seq", -1),
        ("seq", True), ("host_ns", {"read": 1}), ("counts", []), ("events", "overrun"), ("events", [1]),
        ("solver", None), ("solver", "x" * 200), ("gate_logit", "high"),
        ("map", np.full(1350, math.nan, "<f4").tobytes()),
        ("map", np.full(1350, math.inf, "<f4").tobytes()),
    ],
)  # fmt: skip
def test_a_publisher_that_lies_about_one_field_is_rejected(packer, field, value):
    fields = msgpack.unpackb(filled(packer))
    with pytest.raises(FrameError):
        unpack_frame(msgpack.packb(fields | {field: value}), 0)


def test_a_later_runtime_may_add_fields(packer):
    fields = msgpack.unpackb(filled(packer))
    assert unpack_frame(msgpack.packb(fields | {"pressure": 1.0}), 0).sequence == 7
