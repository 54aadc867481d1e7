"""Graphs that a bundle's author could make in bad faith: without end, without bound, or that break when they run."""

import random
from collections.abc import Callable
from typing import Any, Final

import onnx
from onnx import TensorProto, helper


def hostile(graph: bytes, rng: random.Random) -> tuple[bytes, str]:
    """Return a graph with the inputs and outputs of a given one and something else between, and what."""
    name = rng.choice(list(WAYS))
    return WAYS[name](onnx.load_from_string(graph), rng), name


def _rewired(model: Any, nodes: list[Any], constants: dict[str, Any], last: str) -> bytes:
    """Put nodes behind the graph's own: what they make is added to the output."""
    graph = model.graph
    output = graph.output[0].name
    for node in graph.node:
        for at, made in enumerate(node.output):
            if made == output:
                node.output[at] = "honest"
    graph.node.extend(nodes)
    for name, (kind, shape, values) in constants.items():
        graph.initializer.append(helper.make_tensor(name, kind, shape, values))
    graph.node.append(helper.make_node("Add", ["honest", last], [output]))
    return bytes(model.SerializeToString())


def _loop(model: Any, _: random.Random) -> bytes:
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["on"]), helper.make_node("Identity", ["was"], ["is"])], "body",
        [helper.make_tensor_value_info("i", TensorProto.INT64, []),
         helper.make_tensor_value_info("go", TensorProto.BOOL, []),
         helper.make_tensor_value_info("was", TensorProto.FLOAT, [1])],
        [helper.make_tensor_value_info("on", TensorProto.BOOL, []),
         helper.make_tensor_value_info("is", TensorProto.FLOAT, [1])],
    )  # fmt: skip
    nodes = [helper.make_node("Loop", ["times", "yes", "zero"], ["looped"], body=body)]
    constants = {
        "times": (TensorProto.INT64, [], [2**62]), "yes": (TensorProto.BOOL, [], [True]),
        "zero": (TensorProto.FLOAT, [1], [0.0]),
    }  # fmt: skip
    return _rewired(model, nodes, constants, "looped")


def _huge(model: Any, rng: random.Random) -> bytes:
    side = rng.choice((10**5, 10**6, 2**40))
    nodes = [
        helper.make_node("ConstantOfShape", ["sizes"], ["big"]),
        helper.make_node("ReduceMax", ["big"], ["small"], keepdims=0),
    ]
    return _rewired(model, nodes, {"sizes": (TensorProto.INT64, [2], [side, side])}, "small")


def _outer(model: Any, rng: random.Random) -> bytes:
    side = rng.choice((30_000, 100_000))
    constants = {
        "tall": (TensorProto.FLOAT, [side, 1], [0.0] * side),
        "wide": (TensorProto.FLOAT, [1, side], [0.0] * side),
    }
    nodes = [
        helper.make_node(rng.choice(("MatMul", "Add", "Mul")), ["tall", "wide"], ["big"]),
        helper.make_node("GatherElements", ["big", "where"], ["few"]),
    ]
    return _rewired(model, nodes, {**constants, "where": (TensorProto.INT64, [1, 1], [0])}, "few")


def _doubled(model: Any, _: random.Random) -> bytes:
    nodes = [helper.make_node("Concat", [f"d{i}", f"d{i}"], [f"d{i + 1}"], axis=0) for i in range(60)]
    nodes.append(helper.make_node("GatherElements", ["d60", "where"], ["few"]))
    constants = {"d0": (TensorProto.FLOAT, [1, 1], [0.0]), "where": (TensorProto.INT64, [1, 1], [0])}
    return _rewired(model, nodes, constants, "few")


def _padded(model: Any, _: random.Random) -> bytes:
    constants = {
        "image": (TensorProto.FLOAT, [1, 1, 2, 2], [0.0] * 4), "kernel": (TensorProto.FLOAT, [1, 1, 1, 1], [1.0]),
        "where": (TensorProto.INT64, [1, 1, 1, 1], [0]),
    }  # fmt: skip
    nodes = [
        helper.make_node("Conv", ["image", "kernel"], ["big"], pads=[10**6] * 4),
        helper.make_node("GatherElements", ["big", "where"], ["few"]),
        helper.make_node("Reshape", ["few", "flat"], ["flatter"]),
    ]
    return _rewired(model, nodes, {**constants, "flat": (TensorProto.INT64, [2], [1, 1])}, "flatter")


def _breaks(model: Any, _: random.Random) -> bytes:
    """Gathers from beyond an end, which only a run finds out."""
    first = model.graph.input[0].name
    nodes = [
        helper.make_node("Cast", [first], ["index"], to=TensorProto.INT64),
        helper.make_node("Add", ["index", "far"], ["further"]),
        helper.make_node("Reshape", ["further", "flat"], ["line"]),
        helper.make_node("Gather", ["line", "none"], ["picked"], axis=0),
        helper.make_node("Gather", ["few", "picked"], ["gone"], axis=0),
        helper.make_node("Reshape", ["gone", "row"], ["there"]),
    ]
    constants = {
        "far": (TensorProto.INT64, [1], [10**6]), "flat": (TensorProto.INT64, [1], [-1]),
        "none": (TensorProto.INT64, [1], [0]), "few": (TensorProto.FLOAT, [3], [0.0] * 3),
        "row": (TensorProto.INT64, [2], [1, 1]),
    }  # fmt: skip
    return _rewired(model, nodes, constants, "there")


def _elsewhere(model: Any, _: random.Random) -> bytes:
    found = model.graph.initializer[0]
    found.ClearField("raw_data")
    found.ClearField("float_data")
    found.data_location = TensorProto.EXTERNAL
    for key, value in (("location", "../../../../../../../dev/zero"), ("length", str(2**40))):
        found.external_data.add(key=key, value=value)
    return bytes(model.SerializeToString())


def _function(model: Any, _: random.Random) -> bytes:
    made = helper.make_function(
        "own", "f", ["x"], ["y"], [helper.make_node("Identity", ["x"], ["y"])], [helper.make_opsetid("", 18)]
    )
    model.functions.append(made)
    model.opset_import.append(helper.make_opsetid("own", 1))
    nodes = [helper.make_node("f", ["nil"], ["y"], domain="own")]
    return _rewired(model, nodes, {"nil": (TensorProto.FLOAT, [1, 1], [0.0])}, "y")


def _claims(model: Any, rng: random.Random) -> bytes:
    found = rng.choice(list(model.graph.initializer))
    found.dims[:] = rng.choice(([2**40], [-1], [2**31, 2**31], [0], [1] * 500))
    return bytes(model.SerializeToString())


def _operator(model: Any, rng: random.Random) -> bytes:
    rng.choice(list(model.graph.node)).op_type = rng.choice(
        ("Loop", "Scan", "If", "Expand", "Tile", "Range", "RandomNormal", "Resize", "Pad", "NonZero", "MaxPool",
         "Gather", "Concat", "Softmax", "Einsum", "StringSplit", "Relu", "\x1b[2J", "")
    )  # fmt: skip
    return bytes(model.SerializeToString())


WAYS: Final[dict[str, Callable[[Any, random.Random], bytes]]] = {
    "a loop of 2^62": _loop,
    "ConstantOfShape": _huge,
    "an outer product": _outer,
    "doubled sixty times": _doubled,
    "a border of a million pixels": _padded,
    "a run that breaks": _breaks,
    "a constant in another file": _elsewhere,
    "a function": _function,
    "constants that claim": _claims,
    "another operator": _operator,
}
"""By name."""
