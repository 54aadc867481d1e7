"""The uncertain parameters of a skin, with priors from the uncertainties that its description states.

Every parameter is counted in prior standard deviations from the stated value ::

    value = stated + spread z            normal, uniform (spread is the width over sqrt(12)), and shifts
    value = stated exp(spread z)         log_normal, and whatever must stay above 0

so the prior of every z is a standard normal. A quantity that the skin states exactly has no parameter. Only the level
is always free, because the layer's conductivity and the source's current are never known to a percent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.devices.draws import MIN_ELECTRODE_SIZE_RATIO

LEVEL_SPREAD: Final = 0.7
"""Of the logarithm of the level: a factor of two either way."""

COMMON_OFFSET: Final = "common_offset_V"
"""Name of an offset of all rows, which the reading's straight line found."""

COMMON_OFFSET_SPREAD: Final = 0.3
"""Of such an offset, over its size."""

ROOM_MM: Final = 0.05
"""Electrodes keep at least twice this apart: derivatives move them by less."""

CORNER_SIZES: Final = 1.5
"""Sizes that an electrode's centre keeps from a corner, where patches of two sides would overlap."""

LAYER_MODES: Final = "layer"
"""Name of the smooth modes of the layer's log conductivity."""


@dataclass(frozen=True, slots=True)
class ParameterGroup:
    """Some parameters of one kind."""

    name: str
    """As the skin's file calls it."""
    unit: str
    stated: Array
    """(n,)"""
    spread: float
    """Prior standard deviation, of the logarithm where ``logarithmic``."""
    logarithmic: bool = False

    def values(self, z: Array) -> Array:
        """Return (n,) values at z (n,) prior standard deviations from the stated ones."""
        if self.logarithmic:
            return np.asarray(self.stated * np.exp(self.spread * z))
        return np.asarray(self.stated + self.spread * z)

    def clipped(self, z: Array, low: Array, high: Array) -> Array:
        """Return (n,) z whose values are the nearest between bounds (n,)."""
        ends = (np.log(end / self.stated) if self.logarithmic else end - self.stated for end in (low, high))
        return np.clip(z, *(end / self.spread for end in ends))

    def errors(self, z: Array, sd: Array) -> Array:
        """Return (n,) standard errors of the values, of those of z."""
        return np.asarray(self.spread * sd * (self.values(z) if self.logarithmic else 1.0))


class Parameters:
    """All groups of a skin, in order, as one vector of z.

    Args:
        skin: The skin whose uncertainties are the priors.
        n_modes: Smooth modes of the layer.
        more: Additional groups, which the skin does not state: those of presses.
    """

    def __init__(self, skin: Skin, n_modes: int, more: Sequence[ParameterGroup] = ()) -> None:
        layer, ring, own, doubts = skin.layer, skin.electrodes, skin.front_end, skin.may_be_off
        sigma = float(layer.conductivity_S_per_m.nominal(1)[0])
        groups = [
            ParameterGroup("level", "S/m", np.array([sigma]), LEVEL_SPREAD, logarithmic=True),
            *_group("arc_length_mm", "mm", ring.arc_length_mm, N_ELECTRODES),
            *_group("size_mm", "mm", ring.size_mm, N_ELECTRODES),
            *_group("contact_impedance_ohm_m2", "ohm m2", ring.contact_impedance_ohm_m2, N_ELECTRODES, above_0=True),
            *_group("thickness_mm", "mm", layer.thickness_mm, 1, above_0=True),
            *_group("gauge_factor", "", layer.gauge_factor, 1),
            *_group("length_scale", "", layer.length_scale, 1),
            *_group("width_scale", "", layer.width_scale, 1),
            *_group("reference_stretch", "", doubts.reference_stretch, 2),
            *_group("gain", "", own.gain, N_ELECTRODES),
            *_group("offset_V", "V", own.offset_V, N_ELECTRODES),
            *_group("stray_pF", "pF", own.stray_pF, N_ELECTRODES, above_0=True),
            *_group("minus_gain", "", own.minus_gain, 1),
            *_group("sink_share", "", own.sink_share, 1),
        ]
        if n_modes:
            groups.append(ParameterGroup(LAYER_MODES, "", np.zeros(n_modes), 1.0))
        groups.extend(more)
        self.groups: dict[str, ParameterGroup] = {one.name: one for one in groups}
        stops = np.cumsum([len(one.stated) for one in groups])
        self.slices = {
            one.name: slice(int(stop) - len(one.stated), int(stop)) for one, stop in zip(groups, stops, strict=True)
        }
        self.count = int(stops[-1])
        self._skin = skin

    def values(self, name: str, z: Array) -> Array:
        """Return a group's values at z (count,); a group that is not there has its stated ones, or zeros."""
        if name in self.groups:
            return self.groups[name].values(z[self.slices[name]])
        for part in (self._skin.electrodes, self._skin.layer, self._skin.front_end, self._skin.may_be_off):
            quantity = getattr(part, name, None)
            if isinstance(quantity, Quantity):
                each = N_ELECTRODES if part is self._skin.electrodes or name in ("gain", "offset_V", "stray_pF") else 2
                return quantity.nominal(each)
        return np.zeros(N_ELECTRODES)

    def inside(self, z: Array) -> Array:
        """Return the nearest (count,) parameters whose electrodes have room.

        Each stays on its own stretch of the border: half the way to its neighbours, and away from corners. None is
        smaller than half of its stated size, nor larger than twice.
        """
        found, ring = z.copy(), self._skin.electrodes
        sizes = ring.size_mm.nominal(N_ELECTRODES)
        if "size_mm" in self.groups:
            own = self.slices["size_mm"]
            low, high = MIN_ELECTRODE_SIZE_RATIO * sizes, sizes / MIN_ELECTRODE_SIZE_RATIO
            found[own] = self.groups["size_mm"].clipped(z[own], low, high)
            sizes = self.groups["size_mm"].values(found[own])
        if "arc_length_mm" in self.groups:
            own = self.slices["arc_length_mm"]
            low, high = self._room(sizes)
            found[own] = self.groups["arc_length_mm"].clipped(z[own], low, high)
        return found

    def _room(self, sizes: Array) -> tuple[Array, Array]:
        """Return (16,) mm, from and to where the centres of electrodes of some sizes may lie."""
        length, width = self._skin.outline.size_mm
        perimeter, stated = self._skin.outline.perimeter_mm, self._skin.arc_length_mm
        corners = np.array([0.0, length, length + width, 2.0 * length + width])
        ends = []
        for way in (-1.0, 1.0):
            neighbour = (way * (np.roll(stated, -int(way)) - stated)) % perimeter
            corner = ((way * (corners[:, None] - stated)) % perimeter).min(axis=0)
            free = np.minimum(neighbour / 2.0 - sizes / 2.0, corner - CORNER_SIZES * sizes)
            ends.append(stated + way * np.maximum(free - ROOM_MM, 0.0))
        return ends[0], ends[1]

    def one(self, name: str, z: Array) -> float:
        """Return the value of a group of one."""
        return float(self.values(name, z)[0])

    def names(self) -> list[str]:
        """Return (count,) names, those of each electrode with its number."""
        return [
            name if len(group.stated) == 1 else f"{name}[{k}]"
            for name, group in self.groups.items()
            for k in range(len(group.stated))
        ]


def _group(name: str, unit: str, quantity: Quantity, count: int, *, above_0: bool = False) -> list[ParameterGroup]:
    if quantity.law == "exact" or not quantity.spread:
        return []
    stated = quantity.nominal(count)
    if quantity.law == "log_normal":
        return [ParameterGroup(name, unit, stated, quantity.spread, logarithmic=True)]
    spread = quantity.spread if quantity.law == "normal" else quantity.spread / np.sqrt(3.0)
    if above_0 and (stated > 0.0).all():
        return [ParameterGroup(name, unit, stated, float(spread / stated.mean()), logarithmic=True)]
    return [ParameterGroup(name, unit, stated, float(spread))]


def check_contacts(skin: Skin) -> None:
    """Raise ValueError if a skin's contacts are no patches: by those the model moves electrodes."""
    if skin.electrodes.contact != "patch":
        raise ValueError(
            f"skin {skin.name!r}: [electrodes] contact is {skin.electrodes.contact!r}, expected 'patch': contacts on "
            "the edge are not calibrated; state in its file where they are, as measured by hand"
        )
