"""A runtime and a subscriber on two machines: over TCP with keys, with delay and loss, through a partition and back."""

import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.runtime.made_up_skin import virtual_skin

import eitskin

from .far_apart import ADDRESSES, linked

pytestmark = [pytest.mark.slow, pytest.mark.process]

TINY = Path(__file__).parents[1] / "golden/tiny.eitskin"

DELAY_S = 0.025

SUBSCRIBER = """
import json, sys, time
import eitskin

frames_at, control_at, folder = sys.argv[1:]
keys = eitskin.load_client_keys(f"{folder}/server.key", f"{folder}/client.key_secret")
clock = eitskin.measure_clock(control_at, keys=keys, rounds=40)
print(json.dumps({"offset_s": clock.offset_ns / 1e9, "error_s": clock.error_ns / 1e9}), flush=True)
with eitskin.subscribe(frames_at, mode="all", keys=keys, timeout_s=1.0, max_age_s=0.5) as frames:
    while True:
        try:
            frame = next(frames)
        except (eitskin.NoFrame, eitskin.StaleFrame) as error:
            found = {"blind": type(error).__name__}
        else:
            found = {"number": frame.number, "age_s": frame.age_s, "by_clock_s": clock.age_s(frame)}
        print(json.dumps({"at_s": time.perf_counter(), "lost": frames.lost, **found}), flush=True)
"""


@pytest.fixture
def link():
    try:
        with linked(DELAY_S, loss=0.01) as found:
            yield found
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no network namespaces here: {error}")


def test_a_subscriber_on_another_machine_goes_blind_in_a_partition_and_never_gets_an_old_frame(link, tmp_path, capsys):
    eitskin.make_keys(tmp_path / "keys")
    frames_at, control_at = (f"tcp://{ADDRESSES[0]}:{port}" for port in (7000, 7001))
    popen = partial(subprocess.Popen, stdout=subprocess.PIPE, text=True)
    words = ["-m", "eitskin_tools.cli", "run", "--bundle", TINY, "--quiet", "--curve-keys", tmp_path / "keys"]
    words += ["--publish", frames_at, "--control", control_at, "--port"]
    with (
        virtual_skin(noise=0.003) as port,
        popen(link.command(0, sys.executable, *words, port), stderr=subprocess.STDOUT) as runtime,
    ):
        assert "ready" in runtime.stdout.readline()
        words = ["-c", SUBSCRIBER, frames_at, control_at, tmp_path / "keys"]
        try:
            with popen(link.command(1, sys.executable, *words)) as client:
                try:
                    figures = observed(link, client.stdout)
                finally:
                    client.kill()
        finally:
            runtime.terminate()
    with capsys.disabled():
        print(json.dumps(figures))


def observed(link, lines):
    """Take frames, cut the link, heal it and take frames again; return the figures."""

    def take(count):
        return [json.loads(lines.readline()) for _ in range(count)]

    clock = take(1)[0]
    assert abs(clock["offset_s"]) <= clock["error_s"]  # both clocks are this machine's
    before = take(1000)
    seen = [one for one in before if "number" in one]
    gaps = np.diff([one["number"] for one in seen]) - 1
    stale = len(before) - len(seen)
    assert gaps.sum() <= before[-1]["lost"] + stale
    ages_s = np.array([one["age_s"] for one in seen])
    assert ages_s.min() > DELAY_S
    assert all(abs(one["by_clock_s"] - one["age_s"]) <= clock["error_s"] + 0.002 for one in seen)
    dropped = link.counts[1] / sum(link.counts)
    link.cut = True
    while "blind" not in (one := take(1)[0]):
        pass
    blind_at_s = one["at_s"]
    while one["at_s"] < blind_at_s + 3.0:
        one = take(1)[0]
        assert "blind" in one
    link.cut = False
    healed_s = one["at_s"]
    while "blind" in (one := take(1)[0]):
        assert one["at_s"] < healed_s + 30.0
    after = [one, *(one for one in take(500) if "number" in one)]
    assert max(one["age_s"] for one in after) <= 0.5
    return {
        "frames": len(seen), "lost": before[-1]["lost"], "stale": stale, "dropped_packets": round(dropped, 4),
        "age_p50_ms": round(1e3 * float(np.median(ages_s)), 1),
        "age_p99_ms": round(1e3 * float(np.quantile(ages_s, 0.99)), 1),
        "clock_offset_ms": round(1e3 * clock["offset_s"], 2), "clock_error_ms": round(1e3 * clock["error_s"], 2),
        "back_after_s": round(after[0]["at_s"] - healed_s, 2),
    }  # fmt: skip
