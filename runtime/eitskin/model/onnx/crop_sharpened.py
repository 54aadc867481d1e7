"""What of a sharpened head a region needs: a rectangle of cells, two cells wider than the region on each side.

A head that sharpens its map takes 3 x 3 pixels as the nine channels of a cell and mixes a cell with those around it, a
cell further with every convolution. So the last layer is cut down to the cells that some pixels can see, and the
convolutions to the rectangle around these; a rectangle's own border is wrong, but no pixel that is asked for sees it::

    x -- Gemm(W, b) -- GatherElements(cells) -- Reshape (9, 10, 15) -- Conv ... Add -- Reshape (1, 1350)
                                                      map <-- Sigmoid -- GatherElements(pixels) --+

That is a map of 30 x 45 pixels. The last layer of a network that knows the sheet's mirrors computes a part of the map
in each of its images, a row each, and a Reshape puts these behind each other; such a layer is cut to what any image is
asked for.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import UncutError
from eitskin.model.onnx.protobuf import Node, dims_of, fields_of, values_of, with_values

GATHER: Final = "GatherElements"

THROUGH: Final = frozenset({"Sigmoid", "Add", "Mul", "Cast"})
"""Operators that keep every output apart from the others."""

CELL: Final = 3
"""Pixels along a side of a cell."""

Index = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """How to cut a sharpened head."""

    source: str
    """What the last layer gives."""
    kept: npt.NDArray[np.intp]
    """(n,) outputs of the last layer that are needed, ascending."""
    outputs: int
    """How many the last layer has."""
    changed: dict[str, bytes | memoryview]
    """Constants behind the last layer by name, rewritten."""


def sharpened(
    nodes: Sequence[Node],
    producers: Mapping[str, Node],
    tensors: Mapping[str, memoryview],
    pixels: npt.NDArray[np.intp],
    shape: tuple[int, int],
) -> Cells | None:
    """Return how to cut a head so that some pixels are right, or None for a head that does not sharpen.

    Args:
        nodes: Of the graph.
        producers: The node that makes each value, by the value's name.
        tensors: Constants by name.
        pixels: (n,) of the map, at least one.
        shape: Rows and columns of the map.

    Raises:
        UncutError: It sharpens in another way.
    """
    convolutions = [node for node in nodes if node.kind == "Conv"]
    if not convolutions:
        return None
    grouped = producers.get(convolutions[0].inputs[0])
    first = producers.get(grouped.inputs[0]) if grouped is not None else None
    last = next((node for node in reversed(nodes) if node.kind == GATHER), None)
    flat = producers.get(last.inputs[0]) if last is not None else None
    if grouped is None or first is None or last is None or flat is None or first is last:
        raise UncutError("the head sharpens between no two gathers; no region can be cut out of it")
    if (grouped.kind, first.kind, flat.kind) != ("Reshape", GATHER, "Reshape"):
        raise UncutError("the head sharpens between no two gathers; no region can be cut out of it")
    cells = -(-shape[0] // CELL), -(-shape[1] // CELL)
    seen = _seen(pixels, shape, cells, sum(dims_of(tensors[node.inputs[1]])[-1] // 2 for node in convolutions))
    rows, columns = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    box = (slice(None), slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    height, width = len(range(*box[1].indices(cells[0]))), len(range(*box[2].indices(cells[1])))
    read = _index(tensors[first.inputs[1]]).reshape(-1, *cells)[box].reshape(1, -1)
    wanted = np.broadcast_to(seen[box[1:]].reshape(-1), (CELL**2, height * width)).reshape(1, -1)
    source, outputs = _layer(first.inputs[0], producers, tensors, shape)
    image, read = np.divmod(read, outputs)
    kept = np.unique(read[wanted])
    read = image * len(kept) + np.searchsorted(kept, read)
    channel, cell = np.divmod(_index(tensors[last.inputs[1]])[:, pixels], cells[0] * cells[1])
    row, column = np.divmod(cell, cells[1])
    return Cells(
        source,
        kept,
        outputs,
        {
            # cells in the rectangle that nobody sees take any number
            first.inputs[1]: _rewritten(tensors[first.inputs[1]], np.where(wanted, read, 0)),
            grouped.inputs[1]: _rewritten(tensors[grouped.inputs[1]], np.array([1, CELL**2, height, width])),
            flat.inputs[1]: _rewritten(tensors[flat.inputs[1]], np.array([1, CELL**2 * height * width])),
            last.inputs[1]: _rewritten(
                tensors[last.inputs[1]], (channel * height + row - rows[0]) * width + column - columns[0]
            ),
        },
    )


def _layer(
    name: str, producers: Mapping[str, Node], tensors: Mapping[str, memoryview], shape: tuple[int, int]
) -> tuple[str, int]:
    """Return what the last layer gives, and how many outputs it has: all pixels, or a part of them in each image."""
    images = producers.get(name)
    if images is None or images.kind != "Reshape":
        return name, shape[0] * shape[1]
    if -1 not in _index(tensors[images.inputs[1]]):
        raise UncutError("the head puts its images behind each other in a fixed number; no region can be cut out of it")
    return images.inputs[0], _width(images.inputs[0], producers, tensors)


def _width(name: str, producers: Mapping[str, Node], tensors: Mapping[str, memoryview]) -> int:
    """Return how many outputs the last matrix product has, by its bias or its weights."""
    node = producers.get(name)
    if node is not None and node.kind == "Gemm" and len(node.inputs) > 2:
        return int(dims_of(tensors[node.inputs[2]])[-1])
    if node is not None and node.kind in ("MatMul", "MatMulInteger"):
        return int(dims_of(tensors[node.inputs[1]])[-1])
    behind = node.inputs if node is not None and node.kind in THROUGH else ()
    for other in [other for other in behind if other in producers]:
        with suppress(UncutError):
            return _width(other, producers, tensors)
    raise UncutError("the head's last layer is no matrix product; no region can be cut out of it")


def _seen(
    pixels: npt.NDArray[np.intp], shape: tuple[int, int], cells: tuple[int, int], reach: int
) -> npt.NDArray[np.bool_]:
    """Return (rows, columns of cells) which hold some pixels, or are at most ``reach`` cells from those that do."""
    rows, columns = np.divmod(pixels, shape[1])
    seen = np.zeros(cells, dtype=np.bool_)
    for row, column in set(zip((rows // CELL).tolist(), (columns // CELL).tolist(), strict=True)):
        seen[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1] = True
    return seen


def _index(tensor: memoryview) -> Index:
    return np.asarray(values_of(list(fields_of(tensor)), np.dtype("<i8")), dtype=np.int64).reshape(dims_of(tensor))


def _rewritten(tensor: memoryview, values: npt.NDArray[np.integer]) -> bytes:
    return with_values(list(fields_of(tensor)), np.ascontiguousarray(values, dtype="<i8"))
