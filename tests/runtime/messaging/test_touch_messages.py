"""Touches on their way: in frames of who asks, alone for who wants no maps, unseen by everybody else."""

import math
import struct

import msgpack
import pytest

import eitskin
from eitskin.errors import FrameError
from eitskin.messaging.frame import unpack_frame
from eitskin.touches.surface import Surface
from eitskin.touches.touch import LAYOUT
from eitskin.touches.watch import TouchWatch
from eitskin_proto.skin.skin import PAPER

from .publishing import send, wait_for

GRID = PAPER.grid


@pytest.fixture
def packed():
    """The touches of a square of 3 by 3 pixels about pixel (10, 20), in the second frame that shows it."""
    image = GRID.flat_cloud_mm()[2].copy()
    image[9:12, 19:22] = 1.0
    watch, surface = TouchWatch(GRID), Surface(GRID.flat_cloud_mm(), GRID)
    watch.update(image.ravel(), 1, surface, 1_000_000)
    return watch.update(image.ravel(), 2, surface, 1_250_000)


def test_a_client_written_from_the_specification_reads_them(packer, packed):
    packer.put_touches((packed[0], struct.pack("<III", 4, 7, 1), 3))
    for raw in (bytes(packer.message()), bytes(packer.short_message()), packer.touch_message()):
        fields = msgpack.unpackb(raw)
        assert (fields["touch_bytes"], fields["touches_more"]) == (LAYOUT.size, 3)
        touch = fields["touches"]
        at = {name: struct.unpack_from(f"<{kind}", touch, place) for place, kind, name in (
            (0, "I", "id"), (4, "I", "parent"), (8, "f", "age"), (12, "2f", "centre"), (20, "2f", "axes"),
            (28, "f", "angle"), (32, "f", "area"), (36, "f", "peak"), (40, "f", "strength"), (44, "f", "confidence"),
            (48, "3f", "place"), (60, "3f", "normal"), (72, "f", "surface"))}  # fmt: skip
        assert (at["id"], at["parent"], at["age"]) == ((1,), (0,), (0.25,))
        assert at["centre"] == pytest.approx((20.5 * 10 / 3, 10.5 * 10 / 3))
        assert at["place"] == pytest.approx((*at["centre"], 0.0), abs=1e-4)
        assert at["normal"] == pytest.approx((0.0, 0.0, 1.0))
        assert at["area"] + at["surface"] + at["peak"] == pytest.approx((100.0, 100.0, 1.0), rel=1e-5)
        assert math.isnan(at["strength"][0])
        assert math.isnan(at["confidence"][0])
        assert struct.unpack("<III", fields["touch_events"]) == (4, 7, 1)


def test_a_touch_message_is_the_frame_without_its_map(packer, packed):
    packer.put_touches(packed)
    fields, alone = msgpack.unpackb(packer.message()), packer.touch_message()
    assert alone[:1] == b"\xdf"
    assert len(alone) < 1000
    without = {name: value for name, value in fields.items() if name not in ("map", "shape")}
    assert msgpack.unpackb(alone) == without | {"v": 2}
    frame = unpack_frame(alone, 0)
    assert frame.map.shape == (0, 0)
    (touch,) = frame.touches
    assert (touch.id, touch.strength, touch.confidence, frame.touch_list.more) == (1, None, None, 0)
    assert "x 68.3, y 35.0 mm" in str(touch)
    with pytest.raises(FrameError, match="found frames of version 1, expected 2"):
        unpack_frame(alone.replace(b"\xa1v\x02", b"\xa1v\x01"), 0)


def test_each_gets_what_it_asked_for_and_nobody_else_is_disturbed(publisher, packer, packed):
    assert not publisher.asked.touches
    with eitskin.subscribe(publisher.endpoint, mode="all", timeout_s=60) as plain:
        wait_for(publisher, lambda: publisher.wanted)
        assert publisher.asked == (True, False, False)
        with (
            eitskin.subscribe(publisher.endpoint, mode="all", touches=True, timeout_s=60) as beside,
            eitskin.subscribe(publisher.endpoint, mode="all", maps=False, timeout_s=60) as alone,
        ):
            wait_for(publisher, lambda: publisher.asked == (True, True, True) and len(publisher.topics) == 6)
            send(publisher, packer, 1)  # as yet without
            packer.put_touches(packed)
            packer.put("n", 2)
            publisher.send(memoryview(packer.touch_message()))
            send(publisher, packer, 2)
            assert [next(plain).number for _ in range(2)] == [1, 2]
            assert (plain.passed_over, plain.rejected) == (0, 0)
            frame, slim = next(beside), next(alone)
            assert (frame.number, slim.number) == (2, 2)
            assert frame.touches == slim.touches
            assert (frame.map.shape, slim.map.shape) == ((30, 45), (0, 0))
            assert beside.passed_over == 1
        wait_for(publisher, lambda: not publisher.asked.touches)
