"""What each operator of an exported network makes of its operands: its outputs' shapes, and its multiplications.

``RULES`` is the list of operators that may be in a graph. A rule takes :class:`Operands` and returns shapes and work.
It need not find every mistake, which ONNX Runtime does, but it may not make a value out to be smaller than it is.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

Shape = tuple[int, ...]
Made = tuple[list[Shape], int]


class UnknownShapeError(ValueError):
    """A shape depends on what is only computed when the graph runs."""


@dataclass(frozen=True, slots=True)
class Operands:
    """What an operator is given."""

    shapes: list[Shape | None]
    """Of its inputs; None for one that is left out."""
    values: list[list[int] | None]
    """Of inputs that are short integer constants; None for others."""
    attributes: dict[str, int | list[int] | str]
    outputs: int

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
    """Return what shapes broadcast to, by arithmetic alone: nothing of that size is made."""
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
    up = given.number("ceil_mode", 0)
    same = str(given.attributes.get("auto_pad", "")).startswith("SAME")
    return tuple(
        -(-size // step)
        if same
        else max(0, (size + before + after - spread * (width - 1) - 1 + up * (step - 1)) // step + 1)
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


def _squeeze(given: Operands) -> Made:
    shape, axes = given.shape(0), given.constant(1, "axes")
    gone = {axis % len(shape) for axis in axes} if axes else {axis for axis, size in enumerate(shape) if size == 1}
    return [tuple(size for axis, size in enumerate(shape) if axis not in gone)], 0


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
    shape = given.shape(0)
    axis = given.number("axis", 0) % len(shape)
    count = given.outputs
    sizes = given.constant(1, "split") or [-(-shape[axis] // count)] * count
    if len(sizes) != count or min(sizes) < 0:
        raise ValueError("other parts than outputs")
    return [(*shape[:axis], size, *shape[axis + 1 :]) for size in sizes], 0


Rule = Callable[[Operands], Made]

RULES: Final[dict[str, Rule]] = {
    **dict.fromkeys(("Relu", "Sigmoid", "Log", "Clip", "Cast", "Identity", "Tanh", "Exp", "Sqrt", "Neg", "Abs"), _same),
    **dict.fromkeys(("Add", "Sub", "Mul", "Div", "Max", "Min"), _broadcast),
    "DynamicQuantizeLinear": _quantised,
    "Gemm": _gemm,
    **dict.fromkeys(("MatMul", "MatMulInteger"), _matmul),
    "Conv": _conv,
    **dict.fromkeys(("AveragePool", "MaxPool"), _pool),
    "Concat": _concat,
    "Reshape": _reshape,
    "Transpose": _transpose,
    "Unsqueeze": _unsqueeze,
    "Squeeze": _squeeze,
    "Slice": _slice,
    "Gather": _gather,
    "GatherElements": _gather_elements,
    "Split": _split,
}
"""Operators that may be in a graph."""
