"""How far what a skin's file states may be off: what no sheet and no front end can be is refused where it is read.

Within three standard deviations, or the whole of a uniform range, a true value must be one that can be: lengths and
gains above 0, say. Electrodes must keep off their neighbours, most of the time.
"""

from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import Skin

SDS: Final = 3.0
"""Standard deviations that must be possible."""

MOST_LOG: Final = 4.0
"""Standard deviation of a logarithm: three of them are more than five decades."""

POSSIBLE: Final[dict[str, dict[str, tuple[float, float]]]] = {
    "layer": {
        "thickness_mm": (0.01, 100.0),
        "conductivity_S_per_m": (1e-9, 1e9),
        "gauge_factor": (-20.0, 20.0),
        "length_scale": (0.5, 2.0),
        "width_scale": (0.5, 2.0),
    },
    "front_end": {
        "gain": (0.01, 100.0),
        "offset_V": (-10.0, 10.0),
        "minus_gain": (0.1, 10.0),
        "sink_share": (0.1, 10.0),
    },
    "may_be_off": {
        "drift": (-1.5, 1.5),
        "reference_stretch": (-0.3, 0.3),
        "scan_scale": (0.5, 2.0),
    },
}
"""From, to: true values that can be. What is not here is kept within bounds where it is drawn."""


def check_reach(skin: Skin) -> None:
    """Refuse a skin whose true values, as far off as its file says, could not be.

    Raises:
        ValueError: With the key, what was found and what was expected.
    """
    for table in ("layer", "electrodes", "front_end", "may_be_off"):
        part = getattr(skin, table)
        for name in part.__dataclass_fields__:
            quantity = getattr(part, name)
            if isinstance(quantity, Quantity) and quantity.spread:
                where = f"[{table}] {name}"
                _check_logarithm(quantity, where)
                if bounds := POSSIBLE.get(table, {}).get(name):
                    _check_bounds(quantity, where, bounds)
    _check_electrodes(skin)


def _check_logarithm(quantity: Quantity, where: str) -> None:
    if quantity.law != "log_normal":
        return
    if not np.all(quantity.value):
        raise ValueError(f"{where} is log_normal about 0, which is 0 exactly; expected another value, or normal")
    if quantity.spread > MOST_LOG:
        raise ValueError(
            f"{where} log_normal is {quantity.spread:g}, expected at most {MOST_LOG:g}: of the natural logarithm"
        )


def _check_bounds(quantity: Quantity, where: str, bounds: tuple[float, float]) -> None:
    value = np.atleast_1d(np.array(quantity.value, dtype=np.float64))
    if quantity.law == "log_normal":
        ends = np.outer(np.exp([-SDS * quantity.spread, SDS * quantity.spread]), value)
    else:
        off = quantity.spread * (1.0 if quantity.law == "uniform" else SDS)
        ends = np.array([value - off, value + off])
    low, high = float(ends.min()), float(ends.max())
    if not bounds[0] <= low <= high <= bounds[1]:
        how = "" if quantity.law == "uniform" else f" within {SDS:g} standard deviations"
        raise ValueError(
            f"{where} is from {low:.4g} to {high:.4g}{how}, expected between {bounds[0]:g} and {bounds[1]:g}: make its "
            f"{quantity.law} = {quantity.spread:g} smaller"
        )


def _check_electrodes(skin: Skin) -> None:
    """Refuse places that are off by more than half of the room to the next electrode, and sizes by more than a size."""
    ring = skin.electrodes
    arc, size = skin.arc_length_mm, ring.size_mm.nominal(N_ELECTRODES)
    room = (np.roll(arc, -1) - arc) % skin.outline.perimeter_mm - (size + np.roll(size, -1)) / 2.0
    k = int(room.argmin())
    most = float(room[k]) * (1.0 if ring.arc_length_mm.law == "uniform" else 0.5)
    if ring.arc_length_mm.law in ("normal", "uniform") and ring.arc_length_mm.spread > most:
        raise ValueError(
            f"[electrodes] arc_length_mm {ring.arc_length_mm.law} is {ring.arc_length_mm.spread:g}, expected at most "
            f"{most:.4g}: there are {room[k]:.4g} mm between electrodes {k} and {(k + 1) % N_ELECTRODES}, which would "
            "overlap"
        )
    if ring.size_mm.law in ("normal", "uniform") and ring.size_mm.spread > size.min():
        raise ValueError(
            f"[electrodes] size_mm {ring.size_mm.law} is {ring.size_mm.spread:g}, expected at most {size.min():g}, the "
            "size of the smallest"
        )
