"""Regions: rectangles of pixels that a subscriber slices out of whole maps."""

import pytest

import eitskin
from eitskin.messaging.frame import unpack_frame
from eitskin.messaging.regions import Region, whole
from eitskin.messaging.subscriber import Subscriber
from eitskin_proto.skin.skin import PAPER

EVERY = whole(PAPER.grid.shape)


def test_millimetres_take_in_every_pixel_that_they_touch():
    assert (Region.from_mm(0, 0, 150, 100),) == EVERY
    assert Region.from_mm(0, 0, 10, 10) == Region(0, 3, 0, 3)  # a pixel is 10/3 mm: borders on pixels' edges
    assert Region.from_mm(9.9, 20.1, 10.1, 20.2) == Region(6, 7, 2, 4)


@pytest.mark.parametrize("bounds", [(-1, 0, 10, 10), (0, 0, 150.1, 10), (10, 0, 10, 10), (0, 50, 10, 40),
                                    (0, 0, float("nan"), 10), (0, 0, 10, float("inf"))])  # fmt: skip
def test_a_region_that_is_not_on_the_sheet_names_the_sheet(bounds):
    with pytest.raises(ValueError, match="not on the sheet: x is 0 to 150, y 0 to 100 mm"):
        Region.from_mm(*bounds)
    with pytest.raises(ValueError, match="not on the sheet"):
        eitskin.subscribe("ipc:///tmp/none", region_mm=bounds)


def test_a_subscriber_to_a_region_gets_whole_maps_and_slices_them(virtual_skin, running, tmp_path):
    with virtual_skin(touches=[[0.2, 60, 0.3]], touches_wait=True) as port, running(port, tmp_path) as runtime:
        endpoint = runtime.publisher.endpoint
        topics = b"eitskin/region/0/10/5/20", b"eitskin/unchanged", b"\xde"  # of an earlier release
        older = Subscriber(endpoint, topics, 1000, timeout_s=60, keys=None)
        with older, eitskin.subscribe(endpoint, region_mm=(0.0, 0.0, 50.0, 30.0), timeout_s=60) as frames:
            frame = next(frame for frame in frames if frame.solver != "none")
            assert frame.map[frames.region.slices].any()
            assert frame.regions == EVERY
            assert frames.region == Region(0, 9, 0, 15)
            outside = frame.map.copy()
            outside[frames.region.slices] = 0.0
            assert outside.any()
            assert runtime.skin.status()["regions"] == [[0, 30, 0, 45]]
            assert unpack_frame(older._recv(), 0).regions == EVERY
