"""One deformation of the mesh for touches anywhere, assembled and inverted, and the blocks of its touched elements."""

from dataclasses import dataclass, replace

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.devices.device import IDEAL, Device, ideal
from eitskin_sim.fem.borders.cut_blocks import cut_blocks
from eitskin_sim.fem.borders.cut_touches import Cuts, find_cuts
from eitskin_sim.fem.borders.graded_blocks import graded_blocks
from eitskin_sim.fem.contacts import check_apart
from eitskin_sim.fem.forward import System, assemble, conductance_of
from eitskin_sim.fem.inverse import dense_inverse
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.freeform.mesh import ELEMENT_MM, shared_mesh, with_contacts, without_middle
from eitskin_sim.measurement.front_end import to_voltages
from eitskin_sim.scene.bend import metric
from eitskin_sim.scene.layer import is_uneven, relative_conductivity
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.scene.touch_table import TouchTable


@dataclass(frozen=True, slots=True)
class AssembledSheet:
    """One deformation, assembled."""

    system: System
    tensor: Array
    """(n_elements, 3, 3) conductance: components at the middle, their change along x and along y."""
    before: Array
    """(n_elements, 9, 9) blocks without middles."""
    ground: tuple[int, float]
    """The unknown that is tied to the ground, and by how many S."""


@dataclass(frozen=True, slots=True)
class InvertedSheet(AssembledSheet):
    """One deformation, assembled and inverted."""

    inverse: Array
    """(n_dofs, n_dofs) V for 1 A, up to a constant."""
    to_terminals: Array
    """(n_dofs, 16) its columns of the electrodes."""
    at_terminals: Array
    """(16, 16) of the electrodes alone."""

    @property
    def untouched_V(self) -> Array:
        """(104,) V under 1 A with nothing touched."""
        return np.asarray(to_voltages(self.at_terminals))


def inverted_sheet(
    bend: Bend,
    size_mm: float = ELEMENT_MM,
    into: Array | None = None,
    device: Device | None = None,
    skin: Skin = PAPER,
) -> InvertedSheet:
    """Return a deformation, ready for touch sets.

    Args:
        bend: The sheet's shape.
        size_mm: The largest element.
        into: The inverse of a sheet that is needed no more: it is overwritten, which is faster than new memory.
        device: Sheet and electrodes, whose front end comes after; None is what the skin states.
        skin: Whose mesh it is solved on.
    """
    true = device or ideal(skin)
    return inverted_metric(lambda xy: metric(bend, true.sheet, xy), size_mm, into, true, skin)


def inverted_metric(
    first_form: Metric,
    size_mm: float = ELEMENT_MM,
    into: Array | None = None,
    device: Device | None = None,
    skin: Skin = PAPER,
) -> InvertedSheet:
    """Return a sheet of any first fundamental form, ready for touch sets; see :func:`inverted_sheet`."""
    sheet = assembled_metric(first_form, size_mm, device, skin)
    grid = shared_mesh(size_mm, (device or ideal(skin)).electrodes, skin)
    inverse = dense_inverse(grid.lines, sheet.before, sheet.ground, into)
    to_terminals = np.ascontiguousarray(inverse[grid.terminals].T)
    at_terminals = to_terminals[grid.terminals]
    return InvertedSheet(sheet.system, sheet.tensor, sheet.before, sheet.ground, inverse, to_terminals, at_terminals)


def assembled_metric(
    first_form: Metric,
    size_mm: float = ELEMENT_MM,
    device: Device | None = None,
    skin: Skin = PAPER,
    gauge: float = 0.0,
) -> AssembledSheet:
    """Return a sheet of any first fundamental form, assembled.

    A ``gauge`` is added to the gauge factor that device or skin state.
    """
    true = device or ideal(skin)
    if gauge:
        true = replace(true, sheet=replace(true.sheet, gauge_factor=true.sheet.gauge_factor + gauge))
    grid = shared_mesh(size_mm, true.electrodes, skin)
    system = assemble(grid.mesh, true.sheet, true.electrodes, first_form)
    check_apart(system.contacts)
    elements = np.arange(grid.mesh.n_elements)
    density = system.contacts.density(np.full(len(system.contacts.element), system.background))
    before = without_middle(with_contacts(system.background * system.stiffness, elements, density, system.contacts))
    tie = float(system.contacts.area_m2 @ density) / N_ELECTRODES
    middle = int(np.sort(grid.terminals)[N_ELECTRODES // 2])  # far from it rounding adds up: from an end, ten times
    return AssembledSheet(system, _tensors(first_form, system, true.sheet), before, (middle, tie))


def _tensors(first_form: Metric, system: System, sheet: Sheet = IDEAL.sheet) -> Array:
    """Return (n, 3, 3): conductances xx, xy, yy of unit elements at sigma = 1, S, and their change along x and y."""
    mesh = system.mesh

    def at(x: float, y: float) -> Array:
        where = mesh.corners_mm + mesh.sizes_mm * (x, y)
        first = first_form(where)
        found = conductance_of(first, system)
        return found * relative_conductivity(sheet, where, first)[:, None] if is_uneven(sheet) else found

    return np.stack([at(0.5, 0.5), at(1.0, 0.5) - at(0.0, 0.5), at(0.5, 1.0) - at(0.5, 0.0)], axis=-1)


def touched_blocks(sheet: AssembledSheet, cuts: Cuts) -> tuple[Array, Array]:
    """Return the (e, 9, 9) stiffness of touched elements and the (e,) density of contacts on them."""
    stiffness, contacts = sheet.system.stiffness, sheet.system.contacts
    blocks = np.empty((len(cuts.element), 9, 9))
    blocks[: cuts.n_cut] = cut_blocks(cuts.integrals, cuts.element[: cuts.n_cut], sheet.tensor, stiffness)
    whole = slice(cuts.n_cut + cuts.n_graded, None)
    if cuts.graded is not None:
        under = slice(cuts.n_cut, whole.start)
        blocks[under] = graded_blocks(cuts.graded, cuts.element[under], sheet.tensor, stiffness)
    blocks[whole] = cuts.sigma[whole, None, None] * stiffness[cuts.element[whole]]
    fringe, impedance = np.zeros(len(stiffness)), np.ones(len(stiffness))
    fringe[contacts.element], impedance[contacts.element] = contacts.fringe_m, contacts.impedance_ohm_m2
    own, plain = fringe[cuts.element], impedance[cuts.element]
    touched = 1.0 / (plain + own / cuts.sigma)
    untouched = 1.0 / (plain + own)
    return blocks, np.asarray(cuts.share * touched + (1.0 - cuts.share) * untouched)


def sheet_blocks(sheet: AssembledSheet, touches: TouchTable, number: int) -> tuple[Array, Array]:
    """Return the (n_elements, 9, 9) blocks and (m,) densities of one touch set, for a Factor."""
    system = sheet.system
    cuts = find_cuts(touches, np.array([number]), system.mesh)
    stiffness, own = touched_blocks(sheet, cuts)
    blocks = system.background * system.stiffness
    blocks[cuts.element] = stiffness
    density = system.contacts.density(np.full(len(blocks), system.background)[system.contacts.element])
    kappa = np.full(len(blocks), np.nan)
    kappa[cuts.element] = own
    at_contacts = kappa[system.contacts.element]
    return blocks, np.where(np.isnan(at_contacts), density, at_contacts)
