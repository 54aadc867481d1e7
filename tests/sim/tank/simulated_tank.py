"""A tank of our own, read by a front end as the measured one's is: an offset, a gain a pair, a phase, and noise."""

from functools import cache

import numpy as np

from eitskin_proto.sensor.table import FULL_TABLE
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.parts import Scene
from eitskin_sim.tank.disc import EVEN_DEG, Disc, assemble_disc

RADIUS_MM = 30.0
AT = 0.65
"""Of the radius, where objects stand."""
OBJECT_MM = 5.0
CONDUCTS = {"metal": 30.0, "plastic": 0.03}
OFFSET_V = -0.012 + 0.004j


@cache
def volts(objects, element_size_mm=3.0):
    """(208,) V of a tank with (electrode from 1, material) in it."""
    disc = Disc(RADIUS_MM, electrode_width_deg=12.0, contact_impedance_ohm_m2=10.0)
    mesh = scene_mesh(Scene(disc.sheet, disc.electrodes, element_size_mm=element_size_mm))
    at = disc.map.to_disc(mesh.centres_mm)
    sigma = np.ones(mesh.n_elements)
    for electrode, material in objects:
        angle = np.deg2rad(EVEN_DEG[electrode - 1])
        middle = AT * RADIUS_MM * np.array([np.cos(angle), np.sin(angle)])
        sigma[np.hypot(*(at - middle).T) < OBJECT_MM] = CONDUCTS[material]
    return assemble_disc(mesh, disc).factorise(sigma).voltages(FULL_TABLE)


def gains(rng):
    """(16,) of the measured pairs."""
    return 0.0017 * np.exp(2.7j) * (1.0 + 0.03 * rng.standard_normal(16))


def read(rows_V, gain, rng, noise_db=36.0):
    """(208,) complex V as the front end reads them."""
    seen = gain[FULL_TABLE[:, 1]] * rows_V
    noise = 10 ** (-noise_db / 20) * (rng.standard_normal(208) + 1j * rng.standard_normal(208)) / np.sqrt(2)
    return OFFSET_V + seen * (1.0 + noise)


def frame(objects, seed=0, common=0.0):
    """A name and (208, 4) as in a file of a tank; with objects all rows have changed by a common share besides."""
    rng = np.random.default_rng(seed)
    gain = gains(rng)
    water, full = read(volts(()), gain, rng), read((1.0 + common) * volts(tuple(objects)), gain, rng)
    name = "_".join(f"electrode{electrode:02d}_{material}" for electrode, material in objects)
    return f"{name}_{seed}ua_1000hz", np.stack([water.real, water.imag, full.real, full.imag], axis=-1)
