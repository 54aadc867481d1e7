"""Untouched moments of random devices, which the gate of a skin with uncertainties must call untouched.

A data set of random devices holds an untouched moment a deformation. A gate trained on a few hundred of them memorises
those devices, and takes every tenth new one for a touch. Others are drawn here from the same distributions: sheet,
electrodes, what came since the reference, and front end. Both voltages are read through the same front end, and the
reference is the device's own, stretched as it may be ::

    log(V / V0)        V at the bend with what came since, V0 before it

Moments that a gate learns from are of first order about solved nominal sheets (:mod:`eitskin_sim.devices.expansion`):
a thousand a second, so that hardly a device comes twice. Those that measure a gate are solved, each by itself. The
common factor is in neither: it is another in every frame, and is drawn when frames are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.row_gaussian import log_of_ratio
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.dataset.device_files import ATTEMPTS, true_bend, usable_reference
from eitskin_sim.devices import expansion as expanded
from eitskin_sim.devices.device import Device, ideal
from eitskin_sim.devices.draws import DrawnDevice, draw_device, draw_front_end, draw_moment
from eitskin_sim.devices.expansion import Expansion, Fields, expansion, whole_differences
from eitskin_sim.devices.readings import readings, sheet_differences
from eitskin_sim.scene.parts import Bend, LaterChanges

COARSE_MM: Final = 4.5
"""Element size of untouched sheets: 0.08 CPU-seconds a solve, 0.12 with its slopes; log(V / V0) to 2e-4."""

SEED: Final = 0xDE71

GAUGE_STEP: Final = 0.3
"""Distance of a drawn gauge factor from that of the solved sheet, itself drawn, in spreads of its distribution."""

MAX_STRETCH_SD: Final = 2.0
"""Stretches of references are solved up to this many standard deviations."""


def moments(bends: Sequence[Bend], skin: Skin, seed: int) -> Array:
    """Return (n, 104) log(V / V0) of untouched devices, one at each bend and two of a device, all of them solved.

    Args:
        bends: Where.
        skin: What devices are drawn from.
        seed: Of the draws.

    Raises:
        ValueError: The skin's electronics hardly ever read every row by the sign that it has.
    """
    rng = np.random.default_rng([seed, SEED])
    nominal = readings(ideal(skin), sheet_differences(ideal(skin), Bend(), COARSE_MM))
    found = np.empty((len(bends), N_ROWS))
    for start in range(0, len(bends), 2):
        drawn = draw_device(skin, rng)
        before = sheet_differences(drawn.device, drawn.reference_bend, COARSE_MM)
        drawn, own = _usable(drawn, before, nominal, skin, rng)
        for number in range(start, min(start + 2, len(bends))):
            device = drawn.device.since(draw_moment(skin, rng).late)
            solved = sheet_differences(device, true_bend(drawn, bends[number]), COARSE_MM)
            found[number] = log_of_ratio(readings(device, solved), own)
    return found


def drawn_moments(bends: Sequence[Bend], skin: Skin, seed: int, devices: int, each: int = 8) -> Array:
    """Return (devices * each, 104) log(V / V0) of untouched devices, of first order about nominal sheets at bends.

    Args:
        bends: At which nominal sheets are solved, of a true size and gauge factor that are drawn.
        skin: What devices are drawn from.
        seed: Of the draws.
        devices: How many.
        each: Moments of each, at bends drawn from ``bends``.

    Raises:
        ValueError: As :func:`moments` does.
    """
    rng = np.random.default_rng([seed, SEED])
    sheets, flat = Sheets.solved(bends, skin, rng), References.solved(skin)
    return np.concatenate([_device(sheets, flat, skin, each, rng) for _ in range(devices)])


@dataclass(frozen=True, slots=True)
class Sheets:
    """Sheets of the stated device at bends: (n,) expansions, (n, 2) true sizes over the stated, (n,) gauge factors."""

    stated: Device
    states: tuple[Expansion, ...]
    scales: Array
    gauges: Array
    fields: Fields
    """Finds the cosines of a layer."""

    @classmethod
    def solved(cls, bends: Sequence[Bend], skin: Skin, rng: np.random.Generator) -> "Sheets":
        """Return them at bends, of sizes and gauge factors that are drawn."""
        device, layer = ideal(skin), skin.layer
        scales = np.stack([layer.length_scale.draw(rng, len(bends)), layer.width_scale.draw(rng, len(bends))], axis=1)
        gauges = layer.gauge_factor.draw(rng, len(bends))
        states = []
        for bend, (along, across), gauge in zip(bends, scales, gauges, strict=True):
            true = true_bend(DrawnDevice(device, (along, across), (1.0, 1.0)), bend)
            states.append(expansion(_with_gauge(device, gauge), true, COARSE_MM))
        return cls(device, tuple(states), scales, gauges, Fields.of(device.sheet))


@dataclass(frozen=True, slots=True)
class References:
    """The flat sheet of a reference by its stretches: quadratic in their logarithms, as solved at nine of them.

    Args:
        signs: (120,)
        logs: (6, 120) coefficients.
        slopes: (6, slopes, 120) coefficients.
        nominal_V: (104,) of the ideal device, not stretched.
    """

    signs: Array
    logs: Array
    slopes: Array
    nominal_V: Array

    @classmethod
    @lru_cache(maxsize=2)
    def solved(cls, skin: Skin) -> "References":
        """Return those of a skin, kept while the process runs."""
        device, rng = _with_gauge(ideal(skin), 0.0), np.random.default_rng(0)
        stretch = 1.0 + skin.may_be_off.reference_stretch.draw(rng, 1000)
        reach = [
            max(MAX_STRETCH_SD * float(np.std(np.log(scale.draw(rng, 1000) * stretch))), 1e-3)
            for scale in (skin.layer.length_scale, skin.layer.width_scale)
        ]
        steps = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)]) * reach
        states = [
            expansion(device, Bend(stretch_along=float(along), stretch_across=float(across)), COARSE_MM)
            for along, across in np.exp(steps)
        ]
        inverse = np.linalg.pinv(_powers(steps))
        nominal = readings(ideal(skin), sheet_differences(ideal(skin), Bend(), COARSE_MM))
        return cls(
            states[4].signs,
            inverse @ np.array([state.logs for state in states]),
            np.tensordot(inverse, np.array([state.slopes for state in states]), axes=1),
            nominal,
        )

    def of(self, stretches: Array, change: Array) -> Array:
        """Return (n, 120) log |D| of the flat sheet under stretches (n, 2), with (n, slopes) changes of devices."""
        powers = _powers(np.log(stretches))
        slopes = np.einsum("np,psd,ns->nd", powers, self.slopes, change, optimize=True)
        return np.asarray(powers @ self.logs + slopes)


def _powers(steps: Array) -> Array:
    x, y = steps.T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def _device(sheets: Sheets, flat: References, skin: Skin, each: int, rng: np.random.Generator) -> Array:
    """Return (each, 104) log(V / V0) of one device."""
    drawn = draw_device(skin, rng)
    at = rng.integers(len(sheets.states), size=each)
    more = GAUGE_STEP * skin.layer.gauge_factor.spread * rng.standard_normal(each)
    since = [draw_moment(skin, rng).late for _ in range(each)]
    bent, taken = about(sheets, flat, drawn, at, since, more)
    drawn, _ = _usable(drawn, taken[0], flat.nominal_V, skin, rng)
    return log_of_ratio(readings(drawn.device, bent), readings(drawn.device, taken))


def about(
    sheets: Sheets,
    flat: References,
    drawn: DrawnDevice,
    at: npt.NDArray[np.intp],
    since: Sequence[LaterChanges],
    more: Array,
) -> tuple[Array, Array]:
    """Return D (n, 16, 16) of a device at moments, and when its reference was taken, of first order.

    Args:
        sheets: Nominal sheets.
        flat: Of references.
        drawn: The device; its true size and gauge factor are those of the sheets.
        at: (n,) at which sheet it is in each moment.
        since: (n,) What came to its layer since the reference.
        more: (n,) its gauge factor beyond the sheet's.
    """
    device, stated = drawn.device, sheets.stated
    before = np.zeros((len(at), expanded.GAUGE + 1))
    before[:, expanded.PLACES] = np.subtract(device.electrodes.arc_length_mm, stated.electrodes.arc_length_mm)
    before[:, expanded.SIZES] = np.log(device.electrodes.sizes_mm() / stated.electrodes.sizes_mm())
    impedance = device.electrodes.impedances_ohm_m2() / stated.electrodes.impedances_ohm_m2()
    before[:, expanded.IMPEDANCES] = np.log(impedance)
    before[:, expanded.LAYER] = sheets.fields.parts(device.sheet, late=False)
    now, even = before.copy(), replace(device.sheet, field=None)
    now[:, expanded.LAYER] += [sheets.fields.parts(replace(even, late=late), late=True) for late in since]
    now[:, expanded.GAUGE], before[:, expanded.GAUGE] = more, sheets.gauges[at] + more
    states = [sheets.states[number] for number in at]
    logs = [state.logs + change @ state.slopes for state, change in zip(states, now, strict=True)]
    taken = flat.of(sheets.scales[at] * drawn.reference_stretch, before)
    return whole_differences(flat.signs, np.array(logs)), whole_differences(flat.signs, taken)


def _usable(
    drawn: DrawnDevice, before: Array, nominal: Array, skin: Skin, rng: np.random.Generator
) -> tuple[DrawnDevice, Array]:
    """Return a device with electronics that can be used and what it reads when its reference is taken."""
    for _ in range(ATTEMPTS):
        own = readings(drawn.device, before)
        if usable_reference(skin, own, nominal):
            return drawn, own
        drawn = replace(drawn, device=replace(drawn.device, front_end=draw_front_end(skin, rng)))
    raise ValueError(f"skin {skin.name}: no front end of {ATTEMPTS} reads every row; make what is off in it smaller")


def _with_gauge(device: Device, gauge: float) -> Device:
    return replace(device, sheet=replace(device.sheet, gauge_factor=float(gauge)))
