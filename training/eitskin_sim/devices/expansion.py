"""First-order readings of devices near a solved one: a thousand of them for the cost of a solve.

The differences D[k, m] of drives k and pairs m (:mod:`eitskin_sim.devices.readings`) of a nominal device at a bend are
solved once; with the fields x of the drives at hand, the slope of D by anything that changes the system matrix by dA is

    dD[k, m] = - x_k . dA x_m

which costs products, not solves. Slopes are kept of log |D|, in which a factor of the whole layer is exact, by

    place, size and impedance of each electrode     contacts moved beside the mesh's lines, central differences
    layer                                           cosines over the sheet, of which smooth fields are made
    gauge factor                                    the logarithm of the local area stretch is its field

The other values of D follow from 120 of them: D is symmetric, and every drive's pairs add up to none round the ring.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.arrays import Array
from eitskin_sim.devices.device import Device
from eitskin_sim.fem.contacts import contacts_of
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.layer import log_conductivity
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, Sheet

WAVES: Final = (10, 7)
"""Cosines along x and along y: fields of 25 mm correlation have 1e-3 of their variance beyond, on the paper's sheet."""

GRID: Final = (16, 11)
"""Points along x and along y at which a field is looked at to find its cosines."""

PLACE_MM: Final = 0.3
SIZE: Final = 0.05
"""Steps of the central differences; that of sizes is of their logarithm."""

EDGE_SHARE: Final = 1.0 / 6.0
"""Of these steps for contacts on the edge: at their ends current crowds over 0.1 mm, and steps beyond are 17 % off."""

FIRST, SECOND = np.triu_indices(N_ELECTRODES, 1)
"""(120,) drive and pair of each value that D is made of."""

PLACES: Final = slice(0, N_ELECTRODES)
SIZES: Final = slice(N_ELECTRODES, 2 * N_ELECTRODES)
IMPEDANCES: Final = slice(2 * N_ELECTRODES, 3 * N_ELECTRODES)
LAYER: Final = slice(3 * N_ELECTRODES, 3 * N_ELECTRODES + WAVES[0] * WAVES[1])
GAUGE: Final = LAYER.stop
"""The parameter of each slope; the last is the gauge factor."""


@dataclass(frozen=True, slots=True)
class Expansion:
    """One solved state and its slopes.

    Args:
        signs: (120,) of D.
        logs: (120,) log |D|, V for 1 A.
        slopes: (``GAUGE`` + 1, 120) of them: by mm, by logarithms of size, impedance and conductivity, and by the gauge
            factor.
    """

    signs: Array
    logs: Array
    slopes: Array


def expansion(device: Device, bend: Bend, element_size_mm: float) -> Expansion:
    """Return a device's state at a bend and its slopes.

    Args:
        device: Its front end is left out.
        bend: Where.
        element_size_mm: Of the mesh, whose lines follow the device's electrodes.
    """
    sheet, electrodes = device.sheet, device.electrodes
    metric = bend_metric(bend, sheet)
    mesh = scene_mesh(Scene(sheet, electrodes, element_size_mm=element_size_mm))
    factor = assemble(mesh, sheet, electrodes, metric).factorise()
    found = factor.differences()[FIRST, SECOND]
    sigma = np.full(mesh.n_elements, factor.system.background)
    power = factor.element_powers(sigma)[:, FIRST, SECOND]
    middle = factor.system.metric
    area = 0.5 * np.log(middle[:, 0] * middle[:, 2] - middle[:, 1] ** 2)

    def through(changed: Electrodes) -> Array:
        contacts = contacts_of(mesh, sheet, changed, metric)
        return factor.contact_powers(contacts, contacts.density(sigma[contacts.element]))[:, FIRST, SECOND]

    def slope(change: Callable[[float], Electrodes], step: float) -> Array:
        return (through(change(step)) - through(change(-step))) / (2 * step)

    arc, sizes = np.array(electrodes.arc_length_mm), electrodes.sizes_mm()
    share = EDGE_SHARE if electrodes.contact == "edge" else 1.0
    perimeter = 2.0 * sum(sheet.size_mm)

    def placed(step: float) -> Electrodes:
        return replace(electrodes, arc_length_mm=tuple(((arc + step) % perimeter).tolist()))

    def sized(step: float) -> Electrodes:
        return replace(electrodes, size_mm=tuple((sizes * np.exp(step)).tolist()))

    contacts = factor.system.contacts
    slopes = np.concatenate(
        [
            slope(placed, share * PLACE_MM),
            slope(sized, share * SIZE),
            -factor.contact_powers(contacts, contacts.impedance_ohm_m2 * factor.density**2)[:, FIRST, SECOND],
            cosines(mesh.centres_mm, sheet).T @ power,
            -area[None] @ power,
        ]
    )
    return Expansion(np.sign(found), np.log(np.abs(found)), -slopes / found)


def cosines(xy_mm: Array, sheet: Sheet) -> Array:
    """Return the (n, cosines) values of what fields are made of at flat points (n, 2)."""
    along, across = (
        np.cos(np.pi * np.arange(count) * at[:, None] / side)
        for count, at, side in zip(WAVES, xy_mm.T, sheet.size_mm, strict=True)
    )
    return np.asarray((along[:, :, None] * across[:, None, :]).reshape(len(xy_mm), -1))


@dataclass(frozen=True, slots=True)
class Fields:
    """Finds the cosines of a layer's unevenness.

    Args:
        xy_mm: (n, 2) where it is looked at.
        inverse: (cosines, n) that gives them.
    """

    xy_mm: Array
    inverse: Array

    @classmethod
    def of(cls, sheet: Sheet) -> "Fields":
        """Return what finds them on a sheet."""
        lines = [(np.arange(count) + 0.5) * side / count for count, side in zip(GRID, sheet.size_mm, strict=True)]
        xy = np.stack([axis.ravel() for axis in np.meshgrid(*lines)], axis=-1)
        return cls(xy, np.asarray(np.linalg.pinv(cosines(xy, sheet)), dtype=np.float64))

    def parts(self, sheet: Sheet, *, late: bool) -> Array:
        """Return the (cosines,) of log conductivity, with or without what came after the reference."""
        return np.asarray(self.inverse @ log_conductivity(sheet, self.xy_mm, late))


def whole_differences(signs: Array, logs: Array) -> Array:
    """Return D (..., 16, 16) of its (..., 120) signs and logarithms."""
    found = np.zeros((*logs.shape[:-1], N_ELECTRODES, N_ELECTRODES))
    found[..., FIRST, SECOND] = signs * np.exp(logs)
    found += np.swapaxes(found, -1, -2)
    own = np.arange(N_ELECTRODES)
    found[..., own, own] = -found.sum(axis=-1)
    return found
