"""The sheet's two mirror symmetries, as permutations of rows, pixels and units.

Electrodes sit mirror-symmetrically, so the mirror image of a touch on the mirror image of a bend gives the same
voltages in another order. Mirroring x (x -> 150 mm - x) takes electrode k to 4 - k, mirroring y takes it to 12 - k. A
pair (k, k+1) becomes the pair 3 - k or 11 - k with both its ends exchanged: drive and measure change sign together, the
voltage does not. Where the image of (k, m) has the larger number first, reciprocity says that (m, k) is the same.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.grid import GRID_SHAPE, N_PIXELS, N_UNITS, UNIT_SHAPE
from eitskin_proto.sensor.table import N_ELECTRODES, TABLE


@dataclass(frozen=True, slots=True)
class Mirror:
    """One of the four images: ``image[i] = original[permutation[i]]``.

    Args:
        x: Whether x is mirrored.
        y: Whether y is mirrored.
        rows: (104,) permutation of the table's rows.
        pixels: (1350,) permutation of the map.
        units: (126,) permutation of the units.
    """

    x: bool
    y: bool
    rows: npt.NDArray[np.intp]
    pixels: npt.NDArray[np.intp]
    units: npt.NDArray[np.intp]

    def clouds(self, clouds: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return the mirror image of (D, 3, 30, 45) clouds that are centred on the sheet's middle."""
        image = clouds[:, :, :: -1 if self.y else 1, :: -1 if self.x else 1].copy()
        image[:, 0] *= -1 if self.x else 1
        image[:, 1] *= -1 if self.y else 1
        return image


def _rows(x: bool, y: bool) -> npt.NDArray[np.intp]:
    pair = np.arange(N_ELECTRODES)
    if x:
        pair = (3 - pair) % N_ELECTRODES
    if y:
        pair = (11 - pair) % N_ELECTRODES
    where = {(int(k), int(m)): row for row, (k, m) in enumerate(TABLE)}
    images = np.sort(pair[TABLE.astype(np.intp)], axis=1)
    return np.array([where[int(k), int(m)] for k, m in images], dtype=np.intp)


def _cells(shape: tuple[int, int], count: int, x: bool, y: bool) -> npt.NDArray[np.intp]:
    index = np.arange(count).reshape(shape)
    return np.ascontiguousarray(index[:: -1 if y else 1, :: -1 if x else 1].reshape(-1))


def _mirror(x: bool, y: bool) -> Mirror:
    return Mirror(x, y, _rows(x, y), _cells(GRID_SHAPE, N_PIXELS, x, y), _cells(UNIT_SHAPE, N_UNITS, x, y))


MIRRORS: Final = (_mirror(False, False), _mirror(True, False), _mirror(False, True), _mirror(True, True))
"""The sheet itself, mirrored in x, in y, and in both. Each is its own inverse."""
