"""Idle acquisition: few drives while nothing touches, whole scans as soon as something does."""

import io
from dataclasses import replace

import numpy as np
import pytest
from tests.runtime.made_up_skin import begin_touches

from eitskin.errors import BundleError, HandshakeError
from eitskin.pipeline.idle import RETRY_NS, IdleGate
from eitskin.skin import Skin
from eitskin_proto.wire import config_toml
from eitskin_proto.wire.scan_rows import table_rows

DRIVES = config_toml.named("paper").idle_drives
"""Of configuration "paper"."""


def watching(bundle, drives=DRIVES):
    """Return the bundle with an idle gate that adds |dV| over the drives' rows, as its gate does over all."""
    rows = len(table_rows(False, drives))
    weights = np.zeros((2 * rows, 2 * rows), np.float32)
    weights[np.arange(rows), np.arange(rows)] = 1.0
    weights[np.arange(rows), np.arange(rows, 2 * rows)] = -1.0
    arrays = dict(bundle.gate_arrays()) | {
        "idle_drives": np.array([drives], np.uint16),
        "idle_mean": np.zeros(2 * rows, np.float32),
        "idle_scale": np.ones(2 * rows, np.float32),
        "idle_w1": weights,
        "idle_b1": np.zeros(2 * rows, np.float32),
        "idle_w2": np.full(2 * rows, 1 / rows, np.float32),
        "idle_b2": np.zeros(1, np.float32),
        "idle_threshold": np.array([0.02], np.float32),
    }
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return replace(bundle, files={**bundle.files, "gate.npz": stream.getvalue()})


@pytest.fixture
def watchful(tiny):
    return watching(tiny)


def test_the_device_idles_while_untouched_and_wakes_at_a_touch(virtual_skin, watchful):
    with (
        virtual_skin(touches=[[2.0, 3.0, 0.3]], touches_wait=True, rate_hz=100.0) as port,
        Skin(port, bundle=watchful, idle_after_s=0.3) as skin,
    ):
        skin.capture_reference(10)
        begin_touches(port)
        frames = []
        for frame in skin.frames(timeout_s=120.0):
            frames.append(frame)
            if skin.pipeline.record.idle and any(seen.map.any() for seen in frames):
                break  # it has been idle, awake, and is idle again
        assert skin.pipeline.intake.withheld["partial"] == 0
    idle = ["acquisition:idle" in frame.skipped for frame in frames]
    changes = [index for index in range(1, len(frames)) if idle[index] != idle[index - 1]]
    assert [idle[index] for index in changes] == [True, False, True]
    asleep, awake, again = changes
    assert "idle" in frames[asleep].events
    assert "idle" in frames[again].events
    assert "awake" in frames[awake].events
    tripped = next(index for index, frame in enumerate(frames) if frame.touched)
    assert asleep < tripped < awake  # an idle frame, which has no map; others may wait in the line behind it
    assert all(frame.touched for frame in frames[tripped:awake])
    assert (frames[awake - 1].solver, frames[awake].solver) == ("none", "vd2t")
    assert frames[awake].map.any()
    spans_us = np.diff([frame.device_us for frame in frames[asleep + 1 : awake - 1]])
    assert np.median(spans_us) == 50_000  # 20 scans a second
    waited_us = frames[awake].device_us - frames[awake - 1].device_us
    assert waited_us < RETRY_NS / 1000  # a scan after the request, which was made once; the rest is how busy we are


def test_a_bundle_without_an_idle_gate_and_other_drives_are_refused(virtual_skin, tiny, watchful, hello):
    with pytest.raises(BundleError, match="no idle gate"):
        IdleGate(tiny.gate_arrays(), replace(hello, idle_drives=DRIVES))
    with pytest.raises(HandshakeError, match=r"needs scans of the drives \[0, .*; configuration paper has \[1\]"):
        IdleGate(watchful.gate_arrays(), replace(hello, idle_drives=2))
    with pytest.raises(HandshakeError, match="has no idle mode"):
        IdleGate(watchful.gate_arrays(), replace(hello, idle_drives=0))
    with pytest.raises(HandshakeError, match="has 208 rows a scan"):
        IdleGate(watchful.gate_arrays(), replace(hello, idle_drives=DRIVES, rows=208))
    with virtual_skin() as port, pytest.raises(ValueError, match="idle_after_s is 0"):
        Skin(port, bundle=watchful, idle_after_s=0)
