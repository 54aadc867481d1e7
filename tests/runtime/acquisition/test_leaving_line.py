"""A cable that is out for a moment costs frames and not the program, at whatever operation it is pulled."""

import time

import numpy as np
import pytest

from eitskin.acquisition.hotplug import HotPlug
from eitskin.pipeline.idle import IdleMode
from eitskin.skin import Skin

from .leaving_line import ROWS_V
from .leaving_line import Skin as Here

PATIENCE_S = 120.0


def opened(here, bundle):
    return Skin(HotPlug("/dev/here", give_up_s=PATIENCE_S, open_line=here.line), bundle=bundle)


def some(skin, count):
    """Return events of as many frames, in order."""
    frames = skin.frames(timeout_s=PATIENCE_S)
    return [event for _, frame in zip(range(count), frames, strict=False) for event in frame.events]


@pytest.mark.parametrize("number", [1, 3, 8, 14])
def test_a_cable_out_for_a_moment_while_the_skin_is_opened_ends_nothing(tiny, number):
    here = Here()
    here.leaves = lambda _, operation: operation == number
    with opened(here, tiny) as skin:
        assert skin.capture_reference(5).frames == 5
        some(skin, 3)
        assert skin.transport.returns == 1
        assert skin.statistics.frames == 3
    assert here.operations > number


def test_a_cable_out_just_as_another_mode_is_asked_for_ends_nothing(tiny):
    here = Here()
    with opened(here, tiny) as skin:
        skin.capture_reference(5)
        skin.loop.idle = IdleMode(0.05)
        here.leaves = lambda kind, _: kind == "write" and skin.transport.returns == 0
        frames = skin.frames(timeout_s=PATIENCE_S)
        assert any("recovered" in frame.events and skin.transport.returns for frame in frames)
        assert skin.transport.returns == 1


def test_what_happened_at_frames_that_are_withheld_the_next_frame_tells(tiny):
    here = Here()
    with opened(here, tiny) as skin:
        skin.capture_reference(5)
        some(skin, 5)
        here.source.factor = 0.0  # no current until a frame was withheld, and a cloud comes
        revision = skin.set_cloud(skin.description.grid.flat_cloud_mm())

        def flows_again(*_):
            if skin.status()["withheld_by_reason"]["no_signal"]:
                here.source.factor = 1.0

        here.leaves = flows_again
        frame = next(skin.frames(timeout_s=PATIENCE_S))
        assert frame.cloud == revision
        told = frame.events
    assert "withheld:no_signal" in told
    assert "cloud" in told


def test_a_reference_holds_no_frame_from_before_it_was_asked_for(tiny):
    here = Here(rate_hz=20.0)
    with opened(here, tiny) as skin:
        skin.capture_reference(5)
        frames = skin.frames(timeout_s=PATIENCE_S)
        next(frames)
        time.sleep(0.12)  # a busy host reads several frames at once ...
        next(frames)  # ... and takes one of them
        here.source.factor = 1.05
        found = skin.capture_reference(5, force=True)
    np.testing.assert_allclose(found.voltages_V / ROWS_V, 1.05, rtol=1e-3)
