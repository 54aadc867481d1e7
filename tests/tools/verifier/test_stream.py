"""Verdicts behind frames: which frames are verified, what is said meanwhile, and what a verifier's end costs."""

import itertools
import json
import os
import signal
import time

import numpy as np
import pytest

import eitskin
from eitskin_tools import cli
from eitskin_tools.evaluation.verified.untouched_baseline import BASELINE_FRAMES
from eitskin_tools.verifier.feed import LATE_REASON

from .conftest import PATIENCE_S, until

pytestmark = pytest.mark.process

MOVING = [[0.5 + step / 10, 0.6 + step / 10, 0.2 + 0.002 * (step % 50)] for step in range(1500)]
"""A touch that changes every 0.1 s, ten times its frames' noise."""


PRINTED = ["--verified", "--mode", "all", "--timeout-s", "60", "--frames", "2"]


def first(items, condition):
    """Return the first item for which a condition holds; they come for ever."""
    end = time.monotonic() + PATIENCE_S
    for item in items:
        if condition(item):
            return item
        assert time.monotonic() < end, f"it did not come; last {item}"
    raise AssertionError("it did not come")


def test_a_frame_is_followed_by_its_verdict_which_subscribe_prints(streaming, capsys):
    with streaming(touches=MOVING) as stream, stream.subscribed() as verdicts:
        found = first(verdicts, lambda one: one.verified and one.frame is not None)  # it may come before the frames do
        status = stream.skin.status()["verifier"]
        assert verdicts.rejected == verdicts.lost == 0
        assert cli.main(["subscribe", stream.publisher.endpoint, *PRINTED]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert cli.main(["subscribe", stream.publisher.endpoint, *PRINTED, "--json"]) == 0
        printed = json.loads(capsys.readouterr().out)
    assert sum("verified, p 0.25, chi-squared 0." in line for line in lines) == 2
    assert any("behind the frame; " in line and " checked, 0 flagged" in line for line in lines)
    assert (printed["checked"], printed["flagged"], printed["lost"], printed["rejected"]) == (2, 0, 0, 0)
    assert printed["extra_us"]["p50"] > 0
    frame = found.frame
    assert (found.sequence, found.run, found.cloud) == (frame.sequence, frame.run, 0)
    assert frame.map_sequence == frame.sequence  # the one that the map was computed for
    assert found.device_us == frame.device_us
    assert (found.state, found.p_value, found.flagged, found.touches) == ("ready", 0.25, False, ())
    assert found.trusted
    assert 0.19 < found.chi_squared < 0.32
    assert found.host_ns["read"] == frame.host_ns["read"]
    assert found.host_ns["publish"] <= found.host_ns["begin"] <= found.host_ns["end"] <= found.received_ns
    assert frame.received_ns <= found.received_ns
    assert (status["mode"], status["state"], status["restarts"], status["nice"]) == ("always", "ready", 0, 5)
    assert status["checked"] >= 1


def test_a_program_that_gives_volts_has_the_noise_of_its_reference(streaming, tmp_path):
    def scans():
        noise = np.random.default_rng(0)
        while True:
            time.sleep(0.005)
            yield 1e-2 * 300.0 ** (-np.arange(104) / 103) * (1.0 + 1e-3 * noise.standard_normal(104))

    with streaming(source=scans()) as stream, stream.subscribed() as verdicts:
        first(verdicts, lambda one: one.state == "ready")
    assert 5e-4 < float((tmp_path / "spread").read_text()) < 2e-3


def test_what_rests_is_verified_once(streaming):
    with streaming(every_map=True) as stream, stream.subscribed() as verdicts:
        found = first(verdicts, lambda one: one.verified)
        first(verdicts, lambda one: not one.verified)  # it is said each second how the verifier is
        begin = stream.skin.statistics.frames
        until(lambda: stream.skin.statistics.frames > begin + 100)
        assert stream.skin.statistics.frames > found.sequence + 100
        assert len(stream.taken) <= 3  # noise may have looked like a change
        assert stream.feed.counts["flagged"] == 0


def test_the_newest_wins_and_what_was_skipped_is_counted(streaming):
    with streaming(touches=MOVING) as stream:
        stream.tell("hold")
        with stream.subscribed() as verdicts:
            until(lambda: len(stream.taken) == 1)
            begin, skipped = stream.skin.statistics.frames, stream.feed.counts["skipped"]
            until(lambda: stream.skin.statistics.frames > begin + 60)
            stream.tell("hold", off=True)
            one, two = [first(verdicts, lambda one: one.verified) for _ in range(2)]
    assert two.sequence > one.sequence + 40
    assert two.counts["skipped"] >= skipped + 4
    assert two.counts["checked"] == 2


def test_idle_waits_until_nothing_moves(streaming):
    resting = [*MOVING[:30], [3.5, 600.0, 0.9]]
    with streaming("idle", touches=resting) as stream, stream.subscribed() as verdicts:
        found = first(verdicts, lambda one: one.verified and one.chi_squared > 0.8)
        for one, after in itertools.pairwise(stream.taken):
            assert after > one + 1
        assert found.frame is None or found.frame.map_sequence == found.sequence


def test_without_a_model_frames_go_out_unverified_and_it_is_said(streaming):
    with streaming() as stream:
        stream.tell("bad_model")
        with stream.subscribed() as verdicts, eitskin.subscribe(stream.publisher.endpoint, "all") as frames:
            found = first(verdicts, lambda one: one.state == "failed")
            assert (found.why, found.verified, found.trusted) == ("the cloud folds in its own plane", False, False)
            assert found.touches is None
            assert first(frames, lambda frame: frame.solver != "none").map.any()
            stream.tell("bad_model", off=True)
            stream.skin.set_cloud(None)
            assert first(verdicts, lambda one: one.verified).cloud == 1


def test_what_the_sheet_reads_at_rest_is_told_once_for_each_surface(streaming):
    with streaming(touches=[], every_map=True) as stream:
        rested = stream.script / "rested"
        with stream.subscribed():
            until(rested.exists)
            begin = stream.skin.statistics.frames
            until(lambda: stream.skin.statistics.frames > begin + 4 * BASELINE_FRAMES)
            ((frames, most),) = [line.split() for line in rested.read_text().splitlines()]
            assert int(frames) == BASELINE_FRAMES
            assert float(most) < 0.02  # a reference of 10 frames of 0.3 % noise is off by 0.1 %, by 0.4 % in some row
            stream.skin.set_cloud(stream.skin.description.grid.flat_cloud_mm() + 5.0)
            until(lambda: len(rested.read_text().splitlines()) == 2)


def test_the_network_uses_the_shape_that_frames_show_until_a_cloud_is_sent(streaming):
    with streaming(touches=MOVING) as stream, stream.subscribed() as verdicts:
        first(verdicts, lambda one: one.verified)
        found, skin = np.asarray(stream.skin.description.grid.flat_cloud_mm(), dtype="f4"), stream.skin
        found[2] = 2e-3 * (found[0] - 75.0) ** 2
        np.save(stream.script / "partial.npy", found)
        with eitskin.subscribe(stream.publisher.endpoint, "all") as frames:
            (stream.script / "partial.npy").rename(stream.script / "shape.npy")
            shown = first(frames, lambda frame: "cloud:fitted" in frame.events)
        assert (shown.cloud, skin.status()["cloud"], skin.status()["cloud_why"]) == (1, 1, "fitted")
        assert np.array_equal(skin.pipeline.buffers.geometry.given.cloud, found)
        assert first(verdicts, lambda one: one.verified and one.cloud == 1).cloud == 1
        assert len((stream.script / "setups").read_text().split()) == 1, "the verifier holds the shape that it found"
        assert skin.set_cloud(found + 5.0) == 2
        first(verdicts, lambda one: one.verified and one.cloud == 2)
        assert skin.use_cloud(found, is_fitted=True) == (2, ())
        assert skin.status()["cloud_why"] == "given"


def test_clouds_that_the_verifier_ignores_need_no_new_model(streaming):
    with streaming(touches=MOVING, cloud="fitted") as stream, stream.subscribed() as verdicts:
        first(verdicts, lambda one: one.verified)
        stream.skin.set_cloud(stream.skin.description.grid.flat_cloud_mm() + 5.0)
        first(verdicts, lambda one: one.verified and one.cloud == 1)
        assert len((stream.script / "setups").read_text().split()) == 1


def test_a_verifier_that_dies_is_started_again_and_the_stream_goes_on(streaming):
    with (
        streaming(touches=MOVING) as stream,
        stream.subscribed() as verdicts,
        eitskin.subscribe(stream.publisher.endpoint, "all") as frames,
    ):
        first(verdicts, lambda one: one.verified)
        before = next(frames).number
        os.kill(stream.process.pid, signal.SIGKILL)
        found = first(verdicts, lambda one: one.state == "waiting")
        assert "by signal 9 (Killed)" in found.why
        assert "starts again in" in found.why
        first(verdicts, lambda one: one.verified)
        first(frames, lambda frame: "verifier:waiting" in frame.events)
        assert first(frames, lambda frame: "verifier:ready" in frame.events).number > before
        assert frames.lost == 0
        assert stream.skin.status()["verifier"]["restarts"] >= 1


@pytest.mark.slow  # it computes for two seconds, and another comes
def test_a_computation_that_hangs_is_said_and_ended_and_the_stream_goes_on(streaming, monkeypatch):
    monkeypatch.setattr("eitskin_tools.verifier.feed.LATE_NS", 1_000_000_000)  # before it is ended
    with streaming(touches=MOVING) as stream, stream.subscribed() as verdicts:
        first(verdicts, lambda one: one.verified)
        stream.tell("hang")
        late = first(verdicts, lambda one: not one.verified and one.why)
        assert (late.state, late.why) == ("ready", LATE_REASON)
        assert stream.skin.status()["verifier"]["why"] == LATE_REASON
        stream.tell("hang", off=True)
        assert "hung, and was ended" in first(verdicts, lambda one: one.state == "waiting").why
        first(verdicts, lambda one: one.verified)
        assert stream.process.restarts >= 1


def test_one_that_keeps_dying_is_given_up_and_it_is_said(streaming):
    with streaming(max_failures=3) as stream:
        with stream.subscribed() as verdicts:
            first(verdicts, lambda one: one.state in ("ready", "preparing"))
            stream.tell("die")
            os.kill(stream.process.pid, signal.SIGKILL)
            found = first(verdicts, lambda one: one.state == "failed")
            again = first(verdicts, lambda one: one.sequence > found.sequence)
        assert "died as it was told" in found.why
        assert "3 times in a row, so it is not restarted" in found.why
        assert (again.state, again.why) == (found.state, found.why)
        assert stream.process.pid == 0
