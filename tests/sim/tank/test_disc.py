"""A disc solved on a rectangle, against the series that the disc itself has; and against its own turns."""

import numpy as np
import pytest

from eitskin_proto.sensor.table import FULL_TABLE
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.parts import Scene
from eitskin_sim.tank.disc import EVEN_DEG, Disc, assemble_disc

EVEN_CURRENT = 10.0
"""A contact impedance, ohm m^2, at which the current passes a contact evenly: the gap model."""


def mesh_of(disc, element_size_mm=3.0):
    return scene_mesh(Scene(disc.sheet, disc.electrodes, element_size_mm=element_size_mm))


def solved(disc, sigma_of=None, element_size_mm=3.0):
    mesh = mesh_of(disc, element_size_mm)
    sigma = None if sigma_of is None else sigma_of(mesh)
    return assemble_disc(mesh, disc).factorise(sigma).voltages(FULL_TABLE)


def series(disc, modes=4000):
    """The disc's own solution for current that passes contacts evenly: u_n = j_n R / (n sigma t) in every mode n."""
    n, angle = np.arange(1, modes), np.deg2rad(disc.electrodes_deg)
    spread = np.sinc(n * disc.electrode_width_deg / 360.0) ** 2 / n
    mean = np.einsum("nij,n->ij", np.cos(n[:, None, None] * (angle[:, None] - angle)), spread) / np.pi
    pairs = np.eye(16) - np.roll(np.eye(16), 1, axis=1)
    rows = (pairs @ mean @ pairs.T) / (disc.conductivity_S_per_m * 1e-3 * disc.thickness_mm)
    return rows[FULL_TABLE[:, 0], FULL_TABLE[:, 1]]


UNEVEN = tuple(np.array(EVEN_DEG) + np.random.default_rng(0).uniform(-5.0, 5.0, 16))


@pytest.mark.parametrize(("electrodes", "width"), [(EVEN_DEG, 20.0), (UNEVEN, 5.0)])
def test_voltages_are_those_of_the_discs_own_series(electrodes, width):
    disc = Disc(40.0, 3.0, 0.7, electrodes, width, EVEN_CURRENT)
    expected = series(disc)
    assert np.abs(solved(disc) / expected - 1.0).max() < 2e-3
    sheet = assemble(mesh_of(disc), disc.sheet, disc.electrodes).factorise().voltages(FULL_TABLE)
    assert np.abs(sheet / expected - 1.0).max() > 4e-3  # with contacts as long as on the rectangle


def test_a_disc_with_an_object_reads_the_same_when_both_are_turned_by_a_sector():
    """No symmetry of the square is a turn by a sector."""
    disc = Disc(40.0, contact_impedance_ohm_m2=1e-4)

    def rows(k):
        middle = 15.0 * np.array([np.cos(np.deg2rad(22.5 * k)), np.sin(np.deg2rad(22.5 * k))])

        def soft(mesh):
            apart = np.sum((disc.map.to_disc(mesh.centres_mm) - middle) ** 2, axis=1)
            return np.exp(np.log(0.2) * np.exp(-apart / (2 * 8.0**2)))

        full = np.zeros((16, 16))
        full[FULL_TABLE[:, 0], FULL_TABLE[:, 1]] = solved(disc, soft)
        return full

    still, turned = rows(0), np.roll(rows(1), (-1, -1), axis=(0, 1))
    there = still != 0.0
    assert np.abs(turned[there] / still[there] - 1.0).max() < 5e-3
    assert np.abs(rows(0)[there] / solved_bare(disc)[there] - 1.0).max() > 0.1


def solved_bare(disc):
    full = np.zeros((16, 16))
    full[FULL_TABLE[:, 0], FULL_TABLE[:, 1]] = solved(disc)
    return full
