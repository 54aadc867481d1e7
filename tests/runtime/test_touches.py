"""A skin in this process lists touches when asked, on the surface in use, and does nothing of it otherwise."""

from itertools import islice

import numpy as np
import pytest

from eitskin.errors import FrameError
from eitskin_proto.skin.skin import PAPER


def test_frames_have_touches_where_they_are_asked_for_and_only_there(streaming):
    frame = next(streaming.frames())
    assert frame.touch_list is None
    with pytest.raises(FrameError, match="no touches"):
        _ = frame.touches
    for frame in islice(streaming.frames(touches=True), 30):
        assert frame.touch_list is not None
        assert frame.touched or not frame.touches
        for touch in frame.touches:
            assert touch.place_mm[:2] == pytest.approx(touch.centre_mm, abs=1e-4)
            assert frame.map.max() >= touch.peak - 1e-6 >= 0.5 - 1e-6
    assert next(streaming.frames()).touch_list is None


def test_the_surface_in_use_is_the_cloud_in_the_pose_in_which_it_was_given(streaming):
    cloud = PAPER.grid.flat_cloud_mm()
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    streaming.set_cloud(np.einsum("ij,jrc->irc", turn, cloud) + np.array([5.0, 6.0, 700.0])[:, None, None])
    for frame in islice(streaming.frames(), 3):
        assert frame.cloud in (0, 1)
    at = streaming.pipeline.buffers.surface.at(np.array([30.0]), np.array([40.0]))[0]
    assert at == pytest.approx([5.0, 36.0, 740.0, 1.0, 0.0, 0.0], abs=1e-6)
