"""Which graphs run: those of operators that exported networks have, of a size and a work that are known beforehand.

A graph is a program. ONNX has loops that run for years, operators that make a gigabyte of two numbers, tensors that lie
in other files, and functions in functions. None of this is in what ``eitskin export`` makes, and none is needed: here a
graph is a list of operators whose shapes all follow from its constants. They are worked out before ONNX Runtime is
given the graph, which would otherwise compute the constant part of it while it loads.
"""

import math
from collections.abc import Mapping
from typing import Final

from eitskin.errors import BundleError
from eitskin.model.onnx.protobuf import (
    DATA_TYPE,
    DIMS,
    FLOATS,
    GRAPH,
    INITIALISER,
    INT32S,
    INT64S,
    NAME,
    NODE,
    OUTPUT,
    RAW,
    VALUE_INFO,
    Field,
    Node,
    content,
    decoded,
    dims_of,
    fields_of,
    integers,
    node_of,
    signed,
    text,
    unreadable,
)  # fmt: skip
from eitskin.model.onnx.shapes import RULES, Operands, Shape, UnknownShapeError
from eitskin_proto.files.plain import quoted

IR_VERSION, OPSETS, METADATA = 1, 8, 14
MODEL_FIELDS: Final = frozenset({IR_VERSION, 2, 3, 4, 5, 6, GRAPH, OPSETS, METADATA})
"""Of a model: who made it, its graph, its operators' version, metadata. No functions, no training."""

INPUT, GRAPH_NAME, GRAPH_DOC = 11, 2, 10
GRAPH_FIELDS: Final = frozenset({NODE, GRAPH_NAME, INITIALISER, GRAPH_DOC, INPUT, OUTPUT, VALUE_INFO, 14, 16})
"""Of a graph; 15 would be sparse constants."""

LOCATION: Final = 14
TENSOR_FIELDS: Final = frozenset({DIMS, DATA_TYPE, FLOATS, INT32S, INT64S, NAME, RAW, 12, LOCATION, 16})
"""Of a constant; 13 would name another file, and so does its location where it is not 0."""

ATTRIBUTE_FIELDS: Final = frozenset({1, 2, 3, 4, 7, 8, 13, 20})
"""Of an attribute: numbers and texts; 5 would be a constant, 6 and 11 graphs."""

ITEM_BYTES: Final = {1: 4, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 8, 9: 1, 10: 2, 11: 8, 12: 4, 13: 8, 16: 2}
"""Bytes of an element by ONNX's number for its type; texts are not among them."""

NEWEST_OPSET: Final = 25
MOST_NODES: Final = 2048
MOST_CONSTANTS: Final = 4096
LONGEST_INDEX: Final = 64
"""Elements of a constant that says a shape or a range."""

LARGEST_VALUE: Final = 1 << 22
LARGEST_SUM: Final = 1 << 25
"""Elements of a value between two operators, and of all of them; the largest shipped has 16,200, and 140,000."""

MOST_WORK: Final = 1 << 29
"""Multiplications of a run: half a second; the largest shipped graph has 3 million."""


def check_graph(model: bytes) -> None:
    """Refuse a model that could run for long, take much memory or read another file.

    Args:
        model: An ONNX file.

    Raises:
        BundleError: It is none, or holds what exported networks do not have; the message names it.
    """
    fields = list(fields_of(memoryview(model)))
    if {field.number for field in fields} - MODEL_FIELDS:
        raise BundleError("a graph brings functions or a training of its own, expected operators alone")
    for field in fields:
        if field.number == OPSETS:
            domain, version = text(field, 1), _number(content(field), 2)
            if domain not in ("", "ai.onnx") or not 1 <= version <= NEWEST_OPSET:
                raise BundleError(
                    f"a graph needs operators of {quoted(domain)} {version}, expected ONNX's own up to {NEWEST_OPSET}"
                )
    graphs = [content(field) for field in fields if field.number == GRAPH]
    if len(graphs) != 1:
        raise unreadable()
    _check(list(fields_of(graphs[0])))


def _check(graph: list[Field]) -> None:
    if {field.number for field in graph} - GRAPH_FIELDS:
        raise BundleError("a graph holds sparse constants, expected dense ones")
    nodes, constants = ([field for field in graph if field.number == kind] for kind in (NODE, INITIALISER))
    if len(nodes) > MOST_NODES or len(constants) > MOST_CONSTANTS:
        raise BundleError(
            f"a graph has {len(nodes)} operators and {len(constants)} constants, expected at most {MOST_NODES} and "
            f"{MOST_CONSTANTS}"
        )
    shapes: dict[str, Shape] = {}
    values: dict[str, list[int]] = {}
    for field in constants:
        _take_constant(content(field), shapes, values)
    for field in graph:
        if field.number == INPUT:
            name, shape = _declared(field)
            if shapes.setdefault(name, shape) != shape:
                raise BundleError(f"a graph declares {quoted(name)} in two shapes")
    elements = work = 0
    for field in nodes:
        node = node_of(field)
        assert node is not None
        found, cost = _shapes(node, field, shapes, values)
        for name, shape in zip(node.outputs, found, strict=False):
            if name in shapes:
                raise BundleError(f"a graph makes {quoted(name)} twice")
            size = math.prod(shape)
            elements, cost = elements + size, cost + size
            if size > LARGEST_VALUE or elements > LARGEST_SUM:
                raise BundleError(
                    f"a graph's {node.kind} makes {size} elements, expected at most {LARGEST_VALUE}, and "
                    f"{LARGEST_SUM} in all"
                )
            if name:
                shapes[name] = shape
        work += cost
        if work > MOST_WORK:
            raise BundleError(f"a graph's operators multiply {work} times or more, expected at most {MOST_WORK}")


def _shapes(
    node: Node, field: Field, shapes: Mapping[str, Shape], values: Mapping[str, list[int]]
) -> tuple[list[Shape], int]:
    """Return the shapes of what an operator makes, and its multiplications."""
    rule = RULES.get(node.kind)
    if rule is None or text(field, 7) not in ("", "ai.onnx"):
        raise BundleError(f"a graph uses the operator {quoted(node.kind)}, which no exported network has")
    unknown = [name for name in node.inputs if name and name not in shapes]
    if unknown:
        raise BundleError(f"a graph's {node.kind} reads {quoted(unknown[0])} before anything makes it")
    attributes = [content(item) for item in fields_of(content(field)) if item.number == 5]
    given = [shapes[name] if name else None for name in node.inputs]
    known = [values.get(name) for name in node.inputs]
    try:
        return rule(Operands(given, known, dict(map(_attribute, attributes)), len(node.outputs)))
    except UnknownShapeError as error:
        raise BundleError(f"a graph's {node.kind} {error}, expected a shape that its constants tell") from error
    except (IndexError, TypeError, ValueError, ZeroDivisionError, OverflowError) as error:
        raise BundleError(f"a graph's {node.kind} has operands that do not fit each other") from error


def _attribute(data: memoryview) -> tuple[str, int | list[int] | str]:
    fields = list(fields_of(data))
    if {field.number for field in fields} - ATTRIBUTE_FIELDS:
        raise BundleError("an operator of a graph holds a graph or a constant of its own, expected numbers and texts")
    name = _one_text(fields, 1)
    several = [signed(value) for field in fields if field.number == 8 for value in integers(field)]
    if several:
        return name, several
    single = [signed(value) for field in fields if field.number == 3 for value in integers(field)]
    return name, single[-1] if single else _one_text(fields, 4)


def _one_text(fields: list[Field], number: int) -> str:
    found = [decoded(content(field)) for field in fields if field.number == number]
    if len(found) > 1:
        raise unreadable()
    return found[0] if found else ""


def _take_constant(tensor: memoryview, shapes: dict[str, Shape], values: dict[str, list[int]]) -> None:
    fields = list(fields_of(tensor))
    if {field.number for field in fields} - TENSOR_FIELDS or _number(tensor, LOCATION) != 0:
        raise BundleError("a constant of a graph lies in another file, or is of no known kind")
    name, shape = _one_text(fields, NAME), tuple(map(signed, dims_of(tensor)))
    kinds = [value for field in fields if field.number == DATA_TYPE for value in integers(field)]
    if not name or name in shapes or len(kinds) != 1 or kinds[0] not in ITEM_BYTES or min(shape, default=0) < 0:
        raise BundleError(f"a graph's constant {quoted(name)} has a shape or a type that cannot be")
    size = math.prod(shape)
    raw = sum(len(content(field)) for field in fields if field.number == RAW)
    if raw and raw != size * ITEM_BYTES[kinds[0]]:
        raise BundleError(f"a graph's constant {quoted(name)} has {raw} bytes, and another number of elements")
    if not raw and size > len(tensor):  # an element that is stored singly takes a byte at least
        raise BundleError(f"a graph's constant {quoted(name)} claims {size} elements and holds fewer")
    shapes[name] = shape
    if kinds[0] == 7 and size <= LONGEST_INDEX:
        stored = [content(field) for field in fields if field.number == RAW]
        if stored:
            data = bytes(stored[-1])
            values[name] = [int.from_bytes(data[at : at + 8], "little", signed=True) for at in range(0, len(data), 8)]
        else:
            values[name] = [signed(value) for field in fields if field.number == INT64S for value in integers(field)]


def _declared(field: Field) -> tuple[str, Shape]:
    """Return name and shape of an input; no size may be left open."""
    fields = list(fields_of(content(field)))
    name = _one_text(fields, 1)
    level = [content(item) for item in fields if item.number == 2]
    for number in (1, 2):  # TypeProto.tensor_type, then its shape
        level = [content(item) for part in level for item in fields_of(part) if item.number == number]
    if len(level) != 1:
        raise BundleError(f"a graph's input {quoted(name)} has no shape")
    dims = [_number(content(item), 1) for item in fields_of(level[0]) if item.number == 1]
    if min(dims, default=1) < 1:
        raise BundleError(f"a graph's input {quoted(name)} leaves a size open, expected numbers")
    return name, tuple(dims)


def _number(data: memoryview, number: int) -> int:
    """Return a number inside a message, 0 if it has none."""
    found = [value for field in fields_of(data) if field.number == number for value in integers(field)]
    return signed(found[-1]) if found else 0
