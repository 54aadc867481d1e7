"""A skin's mirror symmetries, as permutations of rows, pixels and units.

Where electrodes sit mirror-symmetrically (:mod:`eitskin_proto.skin.symmetry`), the mirror image of a touch on the
mirror image of a bend gives the same voltages in another order. A pair (k, k+1) becomes the pair of its electrodes'
images; one mirror exchanges the pair's ends, so drive and measure change sign together and the voltage does not. Where
the image of (k, m) has the larger number first, reciprocity says that (m, k) is the same. On the paper's sheet
mirroring x (x -> 150 mm - x) takes electrode k to 4 - k, mirroring y takes it to 12 - k.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES, TABLE
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.symmetry import images, near_images
from eitskin_training.network.architecture import Outputs


@dataclass(frozen=True, slots=True)
class Mirror:
    """One of a skin's images: ``image[i] = original[permutation[i]]``.

    Args:
        x: Whether x is mirrored.
        y: Whether y is mirrored.
        rows: (104,) permutation of the table's rows.
        pixels: (n_pixels,) permutation of the map.
        units: (n_units,) permutation of the units.
    """

    x: bool
    y: bool
    rows: npt.NDArray[np.intp]
    pixels: npt.NDArray[np.intp]
    units: npt.NDArray[np.intp]

    def clouds(self, clouds: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return the mirror image of (D, 3, rows, columns) clouds that are centred on the sheet's middle."""
        image = clouds[:, :, :: -1 if self.y else 1, :: -1 if self.x else 1].copy()
        image[:, 0] *= -1 if self.x else 1
        image[:, 1] *= -1 if self.y else 1
        return image


@lru_cache(maxsize=16)
def mirrors(skin: Skin, *, near: bool = False) -> tuple[Mirror, ...]:
    """Return a skin's images, itself first: four, two or one. Each is its own inverse.

    Args:
        skin: Of the network or the data.
        near: Those within millimetres too, which a symmetric network keeps; data are mirrored by exact ones alone.
    """
    shape, units = skin.grid.shape, skin.grid.units
    return tuple(
        Mirror(one.x, one.y, _rows(one.electrodes), _cells(shape, one.x, one.y), _cells(units, one.x, one.y))
        for one in (near_images(skin) if near else images(skin))
    )


def of_outputs(mirrors: Sequence[Mirror], outputs: Outputs) -> npt.NDArray[np.intp]:
    """Return the (n, outputs) permutation of a network's outputs, pixels or units, by each mirror."""
    return np.stack([one.pixels if outputs == "pixels" else one.units for one in mirrors])


def _rows(electrodes: tuple[int, ...]) -> npt.NDArray[np.intp]:
    ends = np.array(electrodes)[np.stack([np.arange(N_ELECTRODES), np.arange(1, N_ELECTRODES + 1) % N_ELECTRODES])]
    first, second = ends
    pair = np.where((first + 1) % N_ELECTRODES == second, first, second)
    where = {(int(k), int(m)): row for row, (k, m) in enumerate(TABLE)}
    found = np.sort(pair[TABLE.astype(np.intp)], axis=1)
    return np.array([where[int(k), int(m)] for k, m in found], dtype=np.intp)


def _cells(shape: tuple[int, int], x: bool, y: bool) -> npt.NDArray[np.intp]:
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    return np.ascontiguousarray(index[:: -1 if y else 1, :: -1 if x else 1].reshape(-1))
