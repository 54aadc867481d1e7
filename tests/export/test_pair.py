"""A smaller network goes into a bundle: the same maps as in its own, and nothing of the larger one is changed."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.golden import make_tiny_bundle
from tests.second_skin import SECOND

from eitskin.model.buffers import Buffers
from eitskin.model.bundle import graphs_of, load_bundle
from eitskin.model.engine import VD2T_SMALL, engines
from eitskin.model.geometry import GeometryGraph
from eitskin.model.manifest import GENTLE
from eitskin_export.bundle import read, write
from eitskin_export.pair import FLIPPED_PIXELS, carried, pair
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.cli import main


def made(path: Path, hidden: int, skin: Any = PAPER, **facts: Any) -> Path:
    """Return a bundle with so many hidden values, and with facts of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(make_tiny_bundle, "HIDDEN", hidden)
        make_tiny_bundle.main(path, skin)
    members, known, of = read(path)
    write(path, members, {**known, **facts}, of)
    return path


@pytest.fixture
def large(tmp_path: Path) -> Path:
    return made(tmp_path / "large.eitskin", 8)


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return made(tmp_path / "small.eitskin", 4, metrics={"int8": {"flipped": 0.0}, "card": {"cc": 0.5}, "gate": {}})


def shown(path: Path) -> dict[str, Any]:
    """Return {solver: map} of a bent sheet."""
    bundle = load_bundle(path)
    buffers, cloud = Buffers(bundle), flat_cloud()
    cloud[2] = 4.0 * np.sin(cloud[0] / 30)
    buffers.use_geometry(GeometryGraph(bundle).geometry(cloud, np.full(104, 0.02, np.float32), 1))
    buffers.change[0] = np.random.default_rng(1).normal(0, 0.1, 104)
    found = {}
    for engine in engines(bundle, buffers):
        engine.infer()
        found[engine.name] = buffers.map[0].copy()
    return found


def test_both_networks_give_what_they_gave_in_bundles_of_their_own(large: Path, small: Path, tmp_path: Path) -> None:
    result = pair(large, small, tmp_path / "both.eitskin")
    both, one, other = shown(tmp_path / "both.eitskin"), shown(large), shown(small)
    for name, image in one.items():
        assert np.array_equal(both[name], image)
    assert np.array_equal(both[VD2T_SMALL], other["vd2t-int8"])
    assert result["bundle"] == load_bundle(tmp_path / "both.eitskin").id
    assert result["small_head_bytes"] < result["large_head_bytes"]


@pytest.mark.parametrize(("share", "head"), [(0.99, "head_int8.onnx"), (1.01, "head.onnx"), (-1.0, "head.onnx")])
def test_a_smaller_head_may_show_a_little_more_or_less_in_8_bits(
    large: Path, tmp_path: Path, share: float, head: str
) -> None:
    flipped = {"metrics": {"int8": {"flipped": share * FLIPPED_PIXELS / PAPER.grid.n_pixels}}}
    big, one = made(tmp_path / "big.eitskin", 64), made(tmp_path / "one.eitskin", 4, **flipped)
    pair(big, one, tmp_path / "both.eitskin")
    assert load_bundle(tmp_path / "both.eitskin").manifest["small"]["head"] == head


@pytest.mark.parametrize(
    ("facts", "skin", "what"),
    [({}, SECOND, "skin found"), ({"labels": "units"}, PAPER, "labels found units, expected area"),
     ({"touches": "lower"}, PAPER, "touches found lower, expected raise"),
     ({"head": {"inputs": ["dv", "bias"], "bias": 4}}, PAPER, "head.inputs found")],
)  # fmt: skip
def test_what_does_not_go_together_is_refused(
    large: Path, tmp_path: Path, facts: dict[str, Any], skin: Any, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    other, out = made(tmp_path / "other.eitskin", 4, skin, **facts), tmp_path / "both.eitskin"
    assert main(["pair", str(large), str(other), "--out", str(out)]) != 0
    error = capsys.readouterr().err
    assert what in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_a_network_for_gentle_touches_goes_besides_and_may_be_larger(large: Path, tmp_path: Path) -> None:
    out, again = tmp_path / "out.eitskin", tmp_path / "again.eitskin"
    other = made(tmp_path / "gentle.eitskin", 64, metrics={"int8": {"flipped": 0.0}, "card": {"cc": 0.6}})
    result = pair(large, other, out, GENTLE)
    found = load_bundle(out)
    assert result["gentle_head_bytes"] > result["large_head_bytes"]
    assert found.beside == {"gentle": 64}
    assert found.manifest["gentle"]["metrics"]["card"] == {"cc": 0.6}
    for name, own in zip(graphs_of(GENTLE), ("geometry.onnx", "head_int8.onnx"), strict=True):
        assert found.files[name] == load_bundle(other).files[own]
    pair(large, made(tmp_path / "small.eitskin", 4), again)
    assert carried(again, out, again) == load_bundle(again).id
    both = load_bundle(again)
    assert both.beside == {"small": 4, "gentle": 64}
    assert both.manifest["gentle"] == found.manifest["gentle"]
    assert all(both.files[name] == found.files[name] for name in graphs_of(GENTLE))


def test_the_command_reports_sizes(
    large: Path, small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "both.eitskin"
    assert main(["pair", str(large), str(small), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["bytes"] == out.stat().st_size
    assert main(["pair", str(large), str(small), "--out", str(out)]) == 0
    assert "with vd2t-small 0.0" in capsys.readouterr().out
    assert main(["pair", str(large), str(small), "--out", str(out), "--gentle"]) == 0
    assert "MB where it shows faint touches alone" in capsys.readouterr().out
