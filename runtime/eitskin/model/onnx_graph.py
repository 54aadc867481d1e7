"""Checks a bundle's ONNX graph before ONNX Runtime loads it, without the ``onnx`` package.

A graph is a program. ONNX has loops that run for years, operators that make a gigabyte from two numbers, tensors in
other files, and nested functions. ``eitskin export`` makes none of this: here a graph is a list of operators whose
shapes all follow from its constants. :func:`check_graph` works out shapes and work beforehand, since ONNX Runtime would
compute the constant part of a graph while it loads. The module reads only what that needs of the nested protobuf
messages: fields, nodes by their inputs and outputs, shapes of tensors.

``RULES`` is the list of operators that a graph may have. A rule takes :class:`Operands` and returns shapes and work. It
need not find every mistake, because ONNX Runtime does, but it must not underestimate a value's size.

Weights that are too small to be computed with are refused (:mod:`eitskin.model.denormals`): those of matrices and of
what has more axes, which are multiplied with what a frame brings. ``eitskin export`` writes 0 in their place. ONNX
Runtime's own switch (``session.set_denormal_as_zero``) would change the arithmetic of the thread that makes the first
session, and of every thread made there later, numpy and the caller's own sums included.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin.errors import BundleError
from eitskin.model.denormals import SMALLEST, is_small
from eitskin_proto.files.plain import quoted

GRAPH: Final = 7
"""Field of ModelProto; those of GraphProto, NodeProto and TensorProto follow."""
NODE, INITIALISER, OUTPUT, VALUE_INFO = 1, 5, 12, 13
USED, MADE, KIND, ATTRIBUTE, DOMAIN = 1, 2, 4, 5, 7
DIMS, DATA_TYPE, FLOATS, INT32S, INT64S, NAME, RAW = 1, 2, 4, 5, 7, 8, 9

LONGEST_VARINT: Final = 10
"""Bytes of a number."""


Value = int | memoryview
"""A number, or the bytes of a text, a message or packed numbers."""

Fields = Mapping[int, Sequence[Value]]
"""The values of a message by the numbers of their fields."""


def fields_of(data: Value) -> Fields:
    """Return the fields of a message.

    Raises:
        BundleError: These bytes are none.
    """
    found: dict[int, list[Value]] = {}
    at, data = 0, content(data)
    while at < len(data):
        key, at = _varint(data, at)
        value: Value = 0
        if key & 7 == 0:
            value, at = _varint(data, at)
        elif key & 7 == 2:
            size, start = _varint(data, at)
            at = start + size
            value = data[start:at]
        elif key & 7 in (1, 5):
            at += 8 if key & 7 == 1 else 4
        else:
            raise unreadable()
        if at > len(data):
            raise unreadable()
        found.setdefault(key >> 3, []).append(value)
    return found


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for number, byte in enumerate(data[at : at + LONGEST_VARINT]):
        value |= (byte & 0x7F) << 7 * number
        if byte < 0x80:
            return value & (1 << 64) - 1, at + number + 1
    raise unreadable()


def unreadable() -> BundleError:
    """Return the error of bytes that are no ONNX model."""
    return BundleError("a graph is not a readable ONNX model")


def content(value: Value) -> memoryview:
    """Return the bytes of a value.

    Raises:
        BundleError: It is a number.
    """
    if isinstance(value, int):
        raise unreadable()
    return value


def numbers(fields: Fields, number: int) -> list[int]:
    """Return the signed numbers of a repeated field, packed or not."""
    found = list[int]()
    for value in fields.get(number, ()):
        if isinstance(value, int):
            found.append(value)
            continue
        at = 0
        while at < len(value):
            one, at = _varint(value, at)
            found.append(one)
    return [(one ^ 1 << 63) - (1 << 63) for one in found]


def last_number(fields: Fields, number: int) -> int:
    """Return a number of a message, 0 if it has none."""
    return (numbers(fields, number) or [0])[-1]


def texts(fields: Fields, number: int) -> list[str]:
    """Return the texts of a repeated field.

    Raises:
        BundleError: One is none.
    """
    try:
        return [bytes(content(value)).decode() for value in fields.get(number, ())]
    except UnicodeDecodeError as error:
        raise unreadable() from error


def text(fields: Fields, number: int) -> str:
    """Return a text of a message, "" if it has none; which of several counts is the library's secret."""
    found = texts(fields, number)
    if len(found) > 1:
        raise unreadable()
    return found[0] if found else ""


Shape = tuple[int, ...]
Made = tuple[list[Shape], int]


class UnknownShapeError(ValueError):
    """A shape depends on values that are only computed when the graph runs."""


@dataclass(frozen=True, slots=True)
class Operands:
    """The inputs of an operator."""

    shapes: list[Shape | None]
    """Of its inputs; None for one that is left out."""
    values: list[list[int] | None]
    """Of inputs that are short integer constants; None for others."""
    attributes: dict[str, int | list[int] | str]

    def shape(self, number: int) -> Shape:
        """Return the shape of an input that must be there."""
        found = self.shapes[number]
        if found is None:
            raise UnknownShapeError("lacks an operand")
        return found

    def constant(self, number: int, name: str = "") -> list[int] | None:
        """Return the values of a constant input, or of the attribute that it once was; None for neither."""
        if number < len(self.shapes) and self.shapes[number] is not None:
            found = self.values[number]
            if found is None:
                raise UnknownShapeError("goes by numbers that are not constant")
            return found
        return self.numbers(name)

    def numbers(self, name: str) -> list[int] | None:
        """Return an attribute that is a list of integers; None if it is not there."""
        found = self.attributes.get(name)
        if found is None or isinstance(found, list):
            return found
        raise UnknownShapeError(f"has {name} of another kind")

    def number(self, name: str, default: int) -> int:
        """Return an attribute that is an integer."""
        found = self.attributes.get(name, default)
        if not isinstance(found, int):
            raise UnknownShapeError(f"has {name} of another kind")
        return found


def _same(given: Operands) -> Made:
    return [given.shape(0)], 0


def _broadcast(given: Operands) -> Made:
    return [_joint([given.shape(number) for number in range(len(given.shapes))])], 0


def _joint(shapes: Sequence[Shape]) -> Shape:
    """Return the broadcast of shapes, without making an array of that size."""
    axes = max(map(len, shapes))
    found = []
    for sizes in zip(*((1,) * (axes - len(shape)) + shape for shape in shapes), strict=True):
        others = {size for size in sizes if size != 1}
        if len(others) > 1:
            raise ValueError("shapes do not fit")
        found.append(others.pop() if others else 1)
    return tuple(found)


def _quantised(given: Operands) -> Made:
    return [given.shape(0), (), ()], 0


def _gemm(given: Operands) -> Made:
    first, second = given.shape(0), given.shape(1)
    if len(first) != 2 or len(second) != 2:
        raise ValueError("no matrices")
    rows, inner = first[::-1] if given.number("transA", 0) else first
    columns = second[0] if given.number("transB", 0) else second[1]
    return [(rows, columns)], rows * inner * columns


def _matmul(given: Operands) -> Made:
    first, second = given.shape(0), given.shape(1)
    if not first or not second:
        raise ValueError("no matrices")
    left, right = (1, *first) if len(first) == 1 else first, (*second, 1) if len(second) == 1 else second
    whole = (*_joint([left[:-2], right[:-2]]), left[-2], right[-1])
    kept = whole if len(first) > 1 else (*whole[:-2], whole[-1])
    return [kept if len(second) > 1 else kept[:-1]], math.prod(whole) * left[-1]


def _slid(given: Operands, shape: Shape, kernel: Sequence[int]) -> Shape:
    """Return the extents that a window leaves as it slides."""
    count = len(kernel)
    if len(shape) != count or min(kernel, default=0) < 1:
        raise ValueError("a window of other axes")
    steps = given.numbers("strides") or [1] * count
    wide = given.numbers("dilations") or [1] * count
    pads = given.numbers("pads") or [0] * (2 * count)
    if min(*steps, *wide, 1) < 1 or min(pads) < 0 or len(pads) != 2 * count:
        raise ValueError("a window that does not move")
    if given.number("ceil_mode", 0) or given.attributes.get("auto_pad", "") not in ("", "NOTSET"):
        raise UnknownShapeError("pads by itself")
    return tuple(
        max(0, (size + before + after - spread * (width - 1) - 1) // step + 1)
        for size, width, step, spread, before, after in zip(
            shape, kernel, steps, wide, pads[:count], pads[count:], strict=True
        )
    )


def _conv(given: Operands) -> Made:
    image, weights = given.shape(0), given.shape(1)
    extents = _slid(given, image[2:], weights[2:])
    work = image[0] * math.prod(extents) * math.prod(weights)
    return [(image[0], weights[0], *extents)], work


def _pool(given: Operands) -> Made:
    image, kernel = given.shape(0), given.numbers("kernel_shape") or []
    found = (*image[:2], *_slid(given, image[2:], kernel))
    return [found], math.prod(found) * math.prod(kernel)


def _concat(given: Operands) -> Made:
    shapes = [given.shape(number) for number in range(len(given.shapes))]
    axis = given.number("axis", 0) % len(shapes[0])
    return [(*shapes[0][:axis], sum(shape[axis] for shape in shapes), *shapes[0][axis + 1 :])], 0


def _reshape(given: Operands) -> Made:
    old, wanted = given.shape(0), given.constant(1)
    if wanted is None:
        raise UnknownShapeError("names no shape")
    if not given.number("allowzero", 0):
        wanted = [old[axis] if size == 0 else size for axis, size in enumerate(wanted)]
    if wanted.count(-1) > 1 or min(wanted, default=1) < -1:
        raise ValueError("no shape")
    rest = math.prod(size for size in wanted if size != -1)
    found = tuple(math.prod(old) // rest if size == -1 else size for size in wanted)
    if math.prod(found) != math.prod(old):
        raise ValueError("another number of elements")
    return [found], 0


def _transpose(given: Operands) -> Made:
    shape = given.shape(0)
    order = given.numbers("perm") or list(range(len(shape)))[::-1]
    if sorted(order) != list(range(len(shape))):
        raise ValueError("no order of axes")
    return [tuple(shape[axis] for axis in order)], 0


def _unsqueeze(given: Operands) -> Made:
    shape, axes = list(given.shape(0)), given.constant(1, "axes") or []
    for axis in sorted(axis % (len(shape) + len(axes)) for axis in axes):
        shape.insert(axis, 1)
    return [tuple(shape)], 0


def _slice(given: Operands) -> Made:
    shape = list(given.shape(0))
    starts, stops = given.constant(1, "starts") or [], given.constant(2, "ends") or []
    axes = given.constant(3, "axes") or list(range(len(starts)))
    steps = given.constant(4) or [1] * len(starts)
    for axis, start, stop, step in zip(axes, starts, stops, steps, strict=True):
        shape[axis] = len(range(shape[axis])[start:stop:step])
    return [tuple(shape)], 0


def _gather(given: Operands) -> Made:
    shape, index = given.shape(0), given.shape(1)
    axis = given.number("axis", 0) % len(shape)
    return [(*shape[:axis], *index, *shape[axis + 1 :])], 0


def _gather_elements(given: Operands) -> Made:
    return [given.shape(1)], 0


def _split(given: Operands) -> Made:
    shape, sizes = given.shape(0), given.constant(1)
    axis = given.number("axis", 0) % len(shape)
    if sizes is None or min(sizes) < 0:
        raise UnknownShapeError("names no sizes")
    return [(*shape[:axis], size, *shape[axis + 1 :]) for size in sizes], 0


Rule = Callable[[Operands], Made]

RULES: Final[dict[str, Rule]] = {
    **dict.fromkeys(("Relu", "Sigmoid", "Log", "Clip", "Cast"), _same),
    **dict.fromkeys(("Add", "Sub", "Mul", "Max"), _broadcast),
    "DynamicQuantizeLinear": _quantised,
    "Gemm": _gemm,
    **dict.fromkeys(("MatMul", "MatMulInteger"), _matmul),
    "Conv": _conv,
    "AveragePool": _pool,
    "Concat": _concat,
    "Reshape": _reshape,
    "Transpose": _transpose,
    "Unsqueeze": _unsqueeze,
    "Slice": _slice,
    "Gather": _gather,
    "GatherElements": _gather_elements,
    "Split": _split,
}
"""Operators that may be in a graph."""


IR_VERSION, OPSETS, METADATA = 1, 8, 14
MODEL_FIELDS: Final = frozenset({IR_VERSION, 2, 3, 4, 5, 6, GRAPH, OPSETS, METADATA})
"""Fields of a model: producer, graph, version of the operators, metadata. No functions, no training."""

INPUT, GRAPH_NAME, GRAPH_DOC = 11, 2, 10
GRAPH_FIELDS: Final = frozenset({NODE, GRAPH_NAME, INITIALISER, GRAPH_DOC, INPUT, OUTPUT, VALUE_INFO, 14, 16})
"""Of a graph; 15 would be sparse constants."""

LOCATION: Final = 14
TENSOR_FIELDS: Final = frozenset({DIMS, DATA_TYPE, FLOATS, INT32S, INT64S, NAME, RAW, 12, LOCATION, 16})
"""Of a constant; 13 would name another file, and so does its location where it is not 0."""

ATTRIBUTE_FIELDS: Final = frozenset({1, 2, 3, 4, 7, 8, 13, 20})
"""Of an attribute: numbers and texts; 5 would be a constant, 6 and 11 graphs."""

FLOAT32: Final = 1
"""ONNX's number for the element type."""

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
    fields = fields_of(memoryview(model))
    if fields.keys() - MODEL_FIELDS:
        raise BundleError("a graph has functions or training of its own, expected operators only")
    for needed in map(fields_of, fields.get(OPSETS, ())):
        domain, version = text(needed, 1), last_number(needed, 2)
        if domain not in ("", "ai.onnx") or not 1 <= version <= NEWEST_OPSET:
            raise BundleError(
                f"a graph needs operators of {quoted(domain)} {version}, expected ONNX's own up to {NEWEST_OPSET}"
            )
    graphs = fields.get(GRAPH, ())
    if len(graphs) != 1:
        raise unreadable()
    _check(fields_of(graphs[0]))


def _check(graph: Fields) -> None:
    if graph.keys() - GRAPH_FIELDS:
        raise BundleError("a graph holds sparse constants, expected dense ones")
    nodes, constants = graph.get(NODE, ()), graph.get(INITIALISER, ())
    if len(nodes) > MOST_NODES or len(constants) > MOST_CONSTANTS:
        raise BundleError(
            f"a graph has {len(nodes)} operators and {len(constants)} constants, expected at most {MOST_NODES} and "
            f"{MOST_CONSTANTS}"
        )
    shapes: dict[str, Shape] = {}
    values: dict[str, list[int]] = {}
    for value in constants:
        _take_constant(content(value), shapes, values)
    for value in graph.get(INPUT, ()):
        name, shape = _declared(fields_of(value))
        if shapes.setdefault(name, shape) != shape:
            raise BundleError(f"a graph declares {quoted(name)} in two shapes")
    elements = work = 0
    for node in map(fields_of, nodes):
        kind = text(node, KIND)
        found, cost = _shapes(kind, node, shapes, values)
        for name, shape in zip(texts(node, MADE), found, strict=False):
            if name in shapes:
                raise BundleError(f"a graph makes {quoted(name)} twice")
            size = math.prod(shape)
            elements, cost = elements + size, cost + size
            if size > LARGEST_VALUE or elements > LARGEST_SUM:
                raise BundleError(
                    f"a graph's {kind} makes {size} elements, expected at most {LARGEST_VALUE}, and "
                    f"{LARGEST_SUM} in all"
                )
            if name:
                shapes[name] = shape
        work += cost
        if work > MOST_WORK:
            raise BundleError(f"a graph's operators multiply {work} times or more, expected at most {MOST_WORK}")


def _shapes(
    kind: str, node: Fields, shapes: Mapping[str, Shape], values: Mapping[str, list[int]]
) -> tuple[list[Shape], int]:
    """Return the shapes of an operator's outputs, and its multiplications."""
    rule = RULES.get(kind)
    if rule is None or text(node, DOMAIN) not in ("", "ai.onnx"):
        raise BundleError(f"a graph uses the operator {quoted(kind)}, which no exported network has")
    inputs = texts(node, USED)
    unknown = [name for name in inputs if name and name not in shapes]
    if unknown:
        raise BundleError(f"a graph's {kind} reads {quoted(unknown[0])} before anything makes it")
    attributes = map(_attribute, map(fields_of, node.get(ATTRIBUTE, ())))
    given = [shapes[name] if name else None for name in inputs]
    try:
        return rule(Operands(given, [values.get(name) for name in inputs], dict(attributes)))
    except UnknownShapeError as error:
        raise BundleError(f"a graph's {kind} {error}, expected a shape that its constants tell") from error
    except (IndexError, TypeError, ValueError, ZeroDivisionError, OverflowError) as error:
        raise BundleError(f"a graph's {kind} has operands that do not fit each other") from error


def _attribute(fields: Fields) -> tuple[str, int | list[int] | str]:
    if fields.keys() - ATTRIBUTE_FIELDS:
        raise BundleError("an operator of a graph holds a graph or a constant of its own, expected numbers and texts")
    single = numbers(fields, 3)
    return text(fields, 1), numbers(fields, 8) or (single[-1] if single else text(fields, 4))


def _take_constant(tensor: memoryview, shapes: dict[str, Shape], values: dict[str, list[int]]) -> None:
    fields = fields_of(tensor)
    if fields.keys() - TENSOR_FIELDS or last_number(fields, LOCATION) != 0:
        raise BundleError("a constant of a graph is in another file, or of an unknown kind")
    name, shape, kinds = text(fields, NAME), tuple(numbers(fields, DIMS)), numbers(fields, DATA_TYPE)
    if not name or name in shapes or len(kinds) != 1 or kinds[0] not in ITEM_BYTES or min(shape, default=0) < 0:
        raise BundleError(f"a graph's constant {quoted(name)} has a shape or a type that cannot be")
    size = math.prod(shape)
    stored = [content(value) for value in fields.get(RAW, ())]
    raw = sum(map(len, stored))
    if raw and raw != size * ITEM_BYTES[kinds[0]]:
        raise BundleError(f"a graph's constant {quoted(name)} has {raw} bytes, and another number of elements")
    if not raw and size > len(tensor):  # an element that is stored singly takes a byte at least
        raise BundleError(f"a graph's constant {quoted(name)} claims {size} elements and holds fewer")
    if kinds[0] == FLOAT32 and len(shape) > 1:
        for part in stored + [content(value) for value in fields.get(FLOATS, ())]:
            if is_small(np.frombuffer(part[: len(part) // 4 * 4], dtype="<f4")).any():
                raise BundleError(f"a graph's constant {quoted(name)} holds numbers below {SMALLEST:g}, expected 0")
    shapes[name] = shape
    if kinds[0] == 7 and size <= LONGEST_INDEX:
        if stored:
            data = bytes(stored[-1])
            values[name] = [int.from_bytes(data[at : at + 8], "little", signed=True) for at in range(0, len(data), 8)]
        else:
            values[name] = numbers(fields, INT64S)


def _declared(fields: Fields) -> tuple[str, Shape]:
    """Return name and shape of an input; no size may be left open."""
    name, level = text(fields, 1), list(fields.get(2, ()))
    for number in (1, 2):  # TypeProto.tensor_type, then its shape
        level = [value for part in level for value in fields_of(part).get(number, ())]
    if len(level) != 1:
        raise BundleError(f"a graph's input {quoted(name)} has no shape")
    dims = [last_number(fields_of(value), 1) for value in fields_of(level[0]).get(1, ())]
    if min(dims, default=1) < 1:
        raise BundleError(f"a graph's input {quoted(name)} leaves a size open, expected numbers")
    return name, tuple(dims)
