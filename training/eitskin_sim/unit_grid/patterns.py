"""Sets of touched units: the paper's 10,259 touch sets, and richer shapes for training.

A touch set is a row of bits, bit ``row * columns + column`` for unit (column, row), and is stored packed: the 126 of
the paper's 9 x 14 units take 16 bytes. The paper's sets are every single unit, every square of 2x2 to 9x9 units, and
random sets of two to four (section V.A). They hold no bar, no L and nothing of five separate pieces, which is where
networks trained on them fail. The richer sets are pieces of random kind at random places ::

    unit  #    bar  ####    rectangle  ###    L  #      T  ###    several pieces  #   ##
                                       ###       ###        #                        #

No set of the published phantoms is ever returned (:mod:`eitskin_sim.scene.published`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.published import is_published

N_PAPER_SETS: Final = 10_259
"""Touch sets in the paper's data: 102,590 samples at 10 bends (section V.A). What 126 units and 384 squares leave of
them are 9,749 random sets of two to four units (FACTS: sample count)."""

MAX_UNITS: Final = 10
"""No richer set touches more units than this."""

Bits = npt.NDArray[np.bool_]
"""(..., units) which units are touched."""

Shape = tuple[int, int]
"""Rows and columns of units."""

TRIES: Final = 10_000
"""Draws that bring nothing new, one after the other, after which a grid has no more sets."""


def pack(units: Bits) -> npt.NDArray[np.uint8]:
    """Return (..., n / 8) bytes of (..., n) bits, the first unit in the highest bit."""
    return np.packbits(units, axis=-1)


def unpack(packed: npt.NDArray[np.uint8], n_units: int = PAPER.grid.n_units) -> Bits:
    """Return (..., n_units) bits of their bytes."""
    return np.unpackbits(packed, axis=-1, count=n_units).astype(np.bool_)


def single_units(shape: Shape = PAPER.grid.units) -> Bits:
    """Return (units, units) bits: every unit alone."""
    return np.eye(shape[0] * shape[1], dtype=np.bool_)


def squares(smallest: int = 2, largest: int = 9, shape: Shape = PAPER.grid.units) -> Bits:
    """Return (squares, units) bits: every square of 2x2 to 9x9 units, at every place; the paper's grid has 384."""
    rows, columns = shape
    found = []
    for side in range(smallest, largest + 1):
        for row in range(rows - side + 1):
            for column in range(columns - side + 1):
                bits = np.zeros(shape, dtype=np.bool_)
                bits[row : row + side, column : column + side] = True
                found.append(bits.ravel())
    return np.array(found)


def paper_touch_sets(seed: int, shape: Shape = PAPER.grid.units) -> Bits:
    """Return (10259, units) bits: the paper's units, squares and random sets, in this order, none twice.

    Args:
        seed: Draws the random sets of two to four units.
        shape: Rows and columns of units.

    Raises:
        ValueError: The grid has not so many sets.
    """
    n_units = shape[0] * shape[1]
    fixed = np.concatenate([single_units(shape), squares(shape=shape)])[:N_PAPER_SETS]
    generator = np.random.default_rng(seed)
    seen = {bits.tobytes() for bits in pack(fixed)}

    def a_few() -> Bits:
        bits = np.zeros(n_units, dtype=np.bool_)
        bits[generator.choice(n_units, size=int(generator.integers(2, 5)), replace=False)] = True
        return bits

    drawn = [_new(a_few, seen, shape) for _ in range(N_PAPER_SETS - len(fixed))]
    return np.concatenate([fixed, np.array(drawn, dtype=np.bool_).reshape(-1, n_units)])


def rich_touch_sets(count: int, seed: int, shape: Shape = PAPER.grid.units) -> Bits:
    """Return (count, units) bits: random bars, rectangles, L's, T's and separate pieces, at most 10 units, none twice.

    Args:
        count: How many sets; the first touches nothing.
        seed: Draws them.
        shape: Rows and columns of units.

    Raises:
        ValueError: The grid has not so many sets.
    """
    generator = np.random.default_rng(seed)
    seen: set[bytes] = set()
    drawn = [np.zeros(shape[0] * shape[1], dtype=np.bool_)]
    drawn += [_new(lambda: _pieces(generator, shape), seen, shape, MAX_UNITS) for _ in range(count - 1)]
    return np.array(drawn[:count])


@dataclass(frozen=True, slots=True)
class UnitContrasts:
    """The contrast of every touched unit of T touch sets, by classes.

    Args:
        number: (T, units) uint8, the class of a touched unit; 255 where none is touched.
        contrast: (classes,) conductivity over the sheet's.
    """

    number: npt.NDArray[np.uint8]
    contrast: npt.NDArray[np.float64]

    def of(self, sets: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
        """Return the (n, units) contrasts of some sets, 1 where nothing is touched."""
        table = np.append(self.contrast, np.ones(256 - len(self.contrast)))
        return np.asarray(table[self.number[sets]], dtype=np.float64)


def touch_classes(
    units: Bits, classes: int, generator: np.random.Generator, shape: Shape = PAPER.grid.units
) -> npt.NDArray[np.uint8]:
    """Return (n, units) classes of touched units, 255 elsewhere: one for every touch, in half of the sets one for all.

    Args:
        units: (n, units) touch sets; units that share a side are one touch.
        classes: How many there are.
        generator: Where draws come from.
        shape: Rows and columns of units.
    """
    found = np.full(units.shape, 255, dtype=np.uint8)
    alike = generator.random(len(units)) < 0.5
    drawn = generator.integers(classes, size=(len(units), MAX_UNITS))
    for row, bits in enumerate(units):
        touch, _ = ndimage.label(bits.reshape(shape))
        number = touch.ravel()[bits] - 1
        found[row, bits] = drawn[row, np.where(alike[row], 0, number % MAX_UNITS)]
    return found


def _new(draw: Callable[[], Bits], seen: set[bytes], shape: Shape, most: int | None = None) -> Bits:
    """Return the first set drawn that has not been seen and touches at most so many units."""
    for _ in range(TRIES):
        bits = draw()
        if (most is None or bits.sum() <= most) and _is_new(bits, seen, shape):
            return bits
    raise ValueError(f"{len(seen)} touch sets are nearly all that {shape[0]} x {shape[1]} units have; ask for fewer")


def _is_new(bits: Bits, seen: set[bytes], shape: Shape) -> bool:
    key = pack(bits).tobytes()
    if key in seen or not bits.any() or is_published(np.flatnonzero(bits).tolist(), shape):
        return False
    seen.add(key)
    return True


def _pieces(generator: np.random.Generator, grid: Shape) -> Bits:
    """Return the (units,) union of one to eight random pieces; many pieces are small ones."""
    count = int(generator.choice(8, p=(0.22, 0.2, 0.17, 0.14, 0.11, 0.08, 0.05, 0.03))) + 1
    bits = np.zeros(grid, dtype=np.bool_)
    for _ in range(count):
        alone = generator.random() < 0.18 * count
        shape = np.ones((1, 1), dtype=np.bool_) if alone else _piece(generator)
        shape = shape[: grid[0], : grid[1]]
        row = int(generator.integers(grid[0] - shape.shape[0] + 1))
        column = int(generator.integers(grid[1] - shape.shape[1] + 1))
        bits[row : row + shape.shape[0], column : column + shape.shape[1]] |= shape
    return bits.ravel()


def _piece(generator: np.random.Generator) -> Bits:
    """Return one small shape, randomly turned and mirrored."""
    kind = generator.choice(5, p=(0.3, 0.25, 0.25, 0.12, 0.08))
    if kind == 0:
        shape = np.ones((1, int(generator.integers(2, 9))), dtype=np.bool_)
    elif kind == 1:
        shape = np.ones((int(generator.integers(2, 4)), int(generator.integers(2, 5))), dtype=np.bool_)
    elif kind == 2:
        shape = np.zeros((int(generator.integers(2, 6)), int(generator.integers(2, 6))), dtype=np.bool_)
        shape[0, :] = shape[:, 0] = True
    elif kind == 3:
        shape = np.zeros((int(generator.integers(2, 4)), int(generator.integers(3, 6))), dtype=np.bool_)
        shape[0, :] = shape[:, int(generator.integers(1, shape.shape[1] - 1))] = True
    else:
        shape = np.eye(int(generator.integers(2, 4)), dtype=np.bool_)
    return np.asarray(np.rot90(shape, k=int(generator.integers(4)))[:, :: int(generator.choice((-1, 1)))])
