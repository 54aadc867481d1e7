"""The benchmarks' own correctness: variants compute the same map, shares are shares. No time is judged here."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin.model.buffers import Buffers
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.engine import HEADS, engines
from eitskin.model.gentle import GentleEngine
from eitskin.model.geometry import GeometryGraph
from eitskin_tools.bench import footprint, frame, line_floor
from eitskin_tools.bench.frame import variants

BUNDLE = Path(__file__).parents[2] / "golden" / "tiny.eitskin"


def test_the_unsplit_graph_gives_the_map_of_the_split_ones() -> None:
    pytest.importorskip("onnx", reason="joining the graphs needs the extra 'train'")
    bundle = load_bundle(BUNDLE)
    ways, _ = variants(bundle, seed=3)
    buffers = Buffers(bundle)
    buffers.use_geometry(GeometryGraph(bundle).geometry(None, None, 0))
    buffers.change[:] = 0.1 * np.random.default_rng(3).standard_normal((1, 104))
    engines(bundle, buffers)[0].infer()
    for name in ("unsplit", "onnxruntime-default"):
        (found,) = ways[name]()  # type: ignore[misc]
        assert found == pytest.approx(buffers.map, abs=1e-5)  # float32 through another order of sums
    assert np.ptp(buffers.map) > 1e-3, "a constant map would agree with anything"


def test_a_network_for_faint_touches_is_timed_by_itself() -> None:
    ways, _ = variants(load_bundle(default_path()))
    assert list(ways)[:3] == ["vd2t", "vd2t-int8", "vd2t-small"]
    assert "with-gentle" in ways
    assert all(not isinstance(ways[name].__self__, GentleEngine) for name in HEADS)  # type: ignore[attr-defined]
    assert "with-gentle" not in variants(load_bundle(BUNDLE))[0]


def test_a_variant_that_cannot_be_had_is_named_with_its_reason() -> None:
    _, missing = variants(load_bundle(BUNDLE))
    assert "recipe" in missing["torch-eager"]  # the tiny bundle was made by hand, not trained


def test_inference_reports_every_variant_against_ours() -> None:
    found = frame.inference(BUNDLE, 10)
    assert found["ours"] == "vd2t"
    assert found["ratios"]["vd2t"] == 1.0
    assert set(found["ratios"]) == set(found["inference_us"]) >= {"vd2t", "vd2t-int8", "tikhonov"}
    for times in found["inference_us"].values():
        assert 0 < times["paced"]["p50"] <= times["paced"]["max"]
        assert 0 < times["warm_cpu"]["p50"] <= times["warm_cpu"]["max"]


@pytest.mark.process
def test_every_packet_crosses_the_bare_line_once_and_takes_time() -> None:
    found = line_floor.floor_ns(500.0, 50)
    assert len(found) == 50
    assert (found > 10_000).all(), "two processes were woken in less than 10 us"


@pytest.mark.process
@pytest.mark.slow
def test_footprint_measures_fresh_interpreters(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    import argparse

    rows = {name: footprint.ROWS[name] for name in ("python", "runtime")}
    monkeypatch.setattr(footprint, "ROWS", {**rows, "broken": "import no_such_module"})
    parser = argparse.ArgumentParser()
    footprint.add_arguments(parser)
    assert footprint.run(parser.parse_args(["--json", "--repeats", "1", "--bundle", str(BUNDLE)])) == 0
    found = json.loads(capsys.readouterr().out)
    python, runtime = found["rows"]
    assert runtime["rss_mb"] > python["rss_mb"] > 1
    assert runtime["load_ms"] > python["load_ms"]
    assert "no_such_module" in found["summary"]["missing"]["broken"]
