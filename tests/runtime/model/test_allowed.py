"""Graphs that could run for ever, take all memory or read another file are refused before ONNX Runtime sees them."""

import random
from pathlib import Path

import pytest

from eitskin.errors import BundleError
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.onnx_graph import check_graph

onnx = pytest.importorskip("onnx", reason="hostile graphs are built with it")

from .hostile_graphs import WAYS  # noqa: E402 -- needs onnx

TINY = Path(__file__).parents[2] / "golden" / "tiny.eitskin"
ALLOWED = {"a run that breaks", "another operator", "constants that claim"}
"""Ways that now and then, or always, leave a graph that is bounded; what it does then is seen elsewhere."""


@pytest.mark.parametrize("path", [default_path("area"), default_path("units"), TINY], ids=lambda path: path.stem)
def test_shipped_graphs_are_allowed(path: Path) -> None:
    files = load_bundle(path).files
    graphs = [name for name in files if name.endswith(".onnx")]
    assert {"geometry.onnx", "head.onnx", "head_int8.onnx"} <= set(graphs)
    for name in graphs:
        check_graph(files[name])


@pytest.mark.parametrize("way", sorted(WAYS.keys() - ALLOWED))
@pytest.mark.parametrize("file", ["geometry.onnx", "head.onnx"])
def test_graphs_without_bound_are_refused_in_a_line(way: str, file: str) -> None:
    graph = load_bundle(TINY).files[file]
    for seed in range(3):
        with pytest.raises(BundleError) as caught:
            check_graph(WAYS[way](onnx.load_from_string(graph), random.Random(seed)))
        assert str(caught.value).isprintable()


def test_every_flipped_or_lost_byte_leaves_a_graph_or_an_error_of_this_kind() -> None:
    graph = load_bundle(TINY).files["geometry.onnx"]
    rng = random.Random(0)
    refused = 0
    for number in range(4000):
        damaged = bytearray(graph)
        damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
        try:
            check_graph(bytes(damaged[: rng.randrange(len(graph))] if number % 2 else damaged))
        except BundleError:
            refused += 1
    assert refused > 2000
