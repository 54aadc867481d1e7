"""Frames of a tank: before and with objects in it, 208 rows each, real and imaginary.

::

    TANK.npz   one array (208, 4) a frame: V of water, real and imaginary, then with objects, real and imaginary
               rows: for each drive s = 0 to 15, m = 0 to 15 where the pairs (s, s + 1) and (s + m, s + m + 1) share no
               electrode: the full table's

An array's name describes the objects in the tank, as ``electrode01_metal_electrode05_plastic_...``: the number of the
electrode, from 1, before each object, and its material. Metal conducts better than water, plastic worse. For another
material, as in ``electrode01_wood``, this is unknown; such objects are counted separately.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, cast, get_args

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import SkinError
from eitskin_proto.files.arrays import read_npz
from eitskin_proto.files.plain import plain, quoted
from eitskin_proto.sensor.table import N_ELECTRODES, N_FULL_ROWS

Complex = npt.NDArray[np.complex128]

Material = Literal["metal", "plastic"]

ELECTRODE_NAME: Final = re.compile(r"electrode([0-9]+)(?:_(?!electrode)([^\W\d_]+))?")

SIGNED_MATERIALS: Final = get_args(Material)
"""Materials whose sign is known."""

LARGEST_FILE: Final = 64 << 20
"""Bytes: ten thousand frames."""

COLUMNS: Final = 4

MIN_V: Final = 1e-9
MAX_V: Final = 1e6
"""The strongest row of water, and any row: no front end reads less, or more; and weights and squares of numbers that
are far smaller or larger are no numbers."""


class TankError(SkinError, ValueError):
    """A file that holds no frames of a tank."""


@dataclass(frozen=True, slots=True)
class Object:
    """Something that stands in the tank."""

    electrode: int
    """That it stands before, from 1."""
    material: Material


@dataclass(frozen=True, slots=True)
class Unknown:
    """Something that stands in the tank, and whose name does not tell whether it conducts better than water."""

    electrode: int
    """That it stands before, from 1."""
    material: str
    """As the name says; empty where it says none."""


@dataclass(frozen=True, slots=True, eq=False)
class TankFrame:
    """One frame."""

    name: str
    water_V: Complex
    """(208,) without objects."""
    objects_V: Complex
    """(208,) with them."""
    objects: tuple[Object, ...]
    """By the name; empty where it says nothing."""
    unknown: tuple[Unknown, ...] = ()
    """By the name: those that cannot be judged."""


def load_tank(path: str | Path) -> list[TankFrame]:
    """Return the frames of a file.

    Raises:
        TankError: There are none, one has another shape, is not finite or not plausible, or a name tells of what cannot
            be.
        FileError: It is no intact file of plain arrays.
        OSError: It cannot be read.
    """
    arrays = read_npz(path, LARGEST_FILE)
    if not arrays:
        raise TankError(f"{path} holds no frame; expected arrays ({N_FULL_ROWS}, {COLUMNS})")
    return [_frame(str(path), name, array) for name, array in arrays.items()]


def _frame(path: str, name: str, array: npt.NDArray[Any]) -> TankFrame:
    where = f"{path}: {quoted(name)}"
    if array.shape != (N_FULL_ROWS, COLUMNS) or array.dtype.kind not in "fiu":
        raise TankError(
            f"{where} is {array.dtype} of shape {array.shape}, expected real numbers ({N_FULL_ROWS}, {COLUMNS}): water "
            "real, imaginary, objects real, imaginary"
        )
    values = array.astype(np.float64)
    if not np.isfinite(values).all():
        raise TankError(f"{where} holds {int((~np.isfinite(values)).sum())} values that are not finite; leave it out")
    if np.abs(values).max() > MAX_V:
        raise TankError(f"{where} goes up to {np.abs(values).max():.3g} V, expected at most {MAX_V:g} V")
    water, objects = values[:, 0] + 1j * values[:, 1], values[:, 2] + 1j * values[:, 3]
    if not np.abs(water).max() > MIN_V:
        raise TankError(
            f"{where}: water reads zeros, {np.abs(water).max():.3g} V at most, so nothing can be compared with it; "
            "leave out the frame"
        )
    named = [(int(number[:5]), material) for number, material in ELECTRODE_NAME.findall(name)]
    electrodes = [electrode for electrode, _ in named]
    for electrode in electrodes:
        if not 1 <= electrode <= N_ELECTRODES:
            raise TankError(f"{where} names electrode {electrode}, expected 1 to {N_ELECTRODES}")
    if len(set(electrodes)) != len(electrodes):
        raise TankError(f"{where} names an electrode twice, expected one object before each")
    return TankFrame(
        plain(name),
        water,
        objects,
        tuple(
            Object(electrode, cast(Material, material)) for electrode, material in named if material in SIGNED_MATERIALS
        ),
        tuple(Unknown(electrode, plain(material)) for electrode, material in named if material not in SIGNED_MATERIALS),
    )
