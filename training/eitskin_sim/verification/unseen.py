"""What may differ between the sheet and the model of its scan, all linear, on one deformation, from one factorisation.

The model has the metric of a smooth surface through the scanned points. A scan without marks divides rows and columns
by arc length, so it misses how stretch is distributed along them; and its noise bends the fitted surface a little. Both
change the conductance tensor K = sigma t0 g^-1 of every element, and so do conductivities that drifted. With the fields
X of the untouched sheet every such change answers as

    dU = - sum over elements of X_e^T dS_e X_e,      dS_e = dK_xx S_xx + dK_xy S_xy + dK_yy S_yy

so the three powers of every element are made once, and a change costs one small product. ::

    stretch     u(x, y) along x and v(x, y) along y, waves whose mean along each row or column is none
    scan        random noise of the scanner, through the same fit
    drift, tilt x, tilt y, gauge       of the conductivity, as in eitskin_sim.verification.nuisance
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.borders.cut_blocks import PRODUCTS
from eitskin_sim.fem.mesh import MM, Metric
from eitskin_sim.freeform.mesh import KEPT, MIDDLE, with_contacts
from eitskin_sim.scene.touch_table import Array
from eitskin_sim.shapes.sheet import TouchedSheet
from eitskin_sim.surface.predict import FittedSurface, fit_cloud
from eitskin_sim.unit_grid.units import to_voltages

MAIN_SD: Final = 0.06
"""Of the wave cos(2 pi x / L) of stretch along the sheet: that of the skin's deformations."""

WAVE_SD: Final = 0.02
"""Of every other wave, over its number."""

WAVES: Final = (6, 4)
"""Half waves along x and along y."""

ORDERS: Final = 3
"""Polynomials across, orders 0 to 2."""

DRAWS: Final = 24
"""Scans whose noise is looked at: its columns are as many."""

SEED: Final = 44_113
"""Of their noise."""


@dataclass(frozen=True, slots=True)
class Doubts:
    """Standard deviations of what may differ."""

    scan_mm: float = 0.1
    drift: float = 0.02
    tilt: float = 0.01
    gauge: float = 0.5
    stretch: float = 1.0
    """Of all waves, over what is usual; 0 for a sheet whose stretch is known."""


@dataclass(frozen=True, slots=True)
class Waves:
    """Waves of stretch: n along x, then those along y."""

    names: tuple[str, ...]
    sd: Array
    """(n + m,)"""
    along: Callable[[Array], Array] = field(repr=False)
    """(k, 2) mm -> (k, n) of u."""
    across: Callable[[Array], Array] = field(repr=False)
    """(k, 2) mm -> (k, m) of v."""

    def stretched(self, metric: Metric, amplitudes: Array) -> Metric:
        """Return a metric with such stretch besides."""
        n = self.along(np.zeros((1, 2))).shape[1]

        def found(xy_mm: Array) -> Array:
            first = metric(xy_mm).copy()
            u = np.exp(self.along(xy_mm) @ amplitudes[:n])
            v = np.exp(self.across(xy_mm) @ amplitudes[n:])
            first[:, 0] *= u * u
            first[:, 1] *= u * v
            first[:, 2] *= v * v
            return first

        return found


def waves_of(skin: Skin = PAPER, size: float = 1.0) -> Waves:
    """Return the waves of a skin's sheet."""
    length, width = skin.outline.size_mm
    names, sd = [], []
    for axis, count in (("x", WAVES[0]), ("y", WAVES[1])):
        for wave in range(1, count + 1):
            for order in range(ORDERS):
                names.append(f"stretch {axis}{wave}.{order}")
                main = axis == "x" and wave == 2 and order == 0
                sd.append(size * (MAIN_SD if main else WAVE_SD / wave))

    def waves(at: Array, extent: float, other: Array, other_extent: float, count: int) -> Array:
        t = 2.0 * other / other_extent - 1.0
        powers = np.stack([np.ones_like(t), t, 1.5 * t * t - 0.5], axis=-1)
        cosines = np.cos(np.pi * np.arange(1, count + 1) * at[:, None] / extent)
        return np.asarray((cosines[:, :, None] * powers[:, None, :]).reshape(len(at), -1))

    return Waves(
        tuple(names),
        np.array(sd),
        lambda xy: waves(xy[:, 0], length, xy[:, 1], width, WAVES[0]),
        lambda xy: waves(xy[:, 1], width, xy[:, 0], length, WAVES[1]),
    )


@dataclass(frozen=True, slots=True)
class Unseen:
    """All changes of one deformation."""

    names: tuple[str, ...]
    """Of those that are named; waves come first, scans last and have no names."""
    columns: Array
    """(104, m) V for one standard deviation of each, under 1 A, untouched."""
    waves: Waves
    by_log_sigma: Array
    """(n_elements, 104) V by log conductivity of each element, untouched."""


def powers(touched: TouchedSheet) -> Array:
    """Return (3, n_elements, 104): - X_e^T S_c X_e for the xx, xy and yy parts, untouched."""
    sheet, grid = touched.sheet, touched.grid
    elements = np.arange(len(sheet.before))
    contacts = sheet.system.contacts
    density = contacts.density(np.full(len(contacts.element), sheet.system.background))
    whole = with_contacts(sheet.system.background * sheet.system.stiffness, elements, density, contacts)
    padded = np.concatenate([sheet.to_terminals, np.zeros((1, 16))])
    outer = padded[grid.dofs]  # (e, 9, 16), the electrode last
    middle = -(whole[:, MIDDLE, KEPT][:, None, :] @ outer) / whole[:, MIDDLE, MIDDLE][:, None, None]
    fields = np.insert(outer[:, :8], MIDDLE, middle[:, 0], axis=1)
    tables = PRODUCTS.sum(axis=0).reshape(3, 9, 9)
    flipped = np.swapaxes(fields, 1, 2)
    return np.array([-to_voltages(flipped @ (table @ fields)) for table in tables])


def unseen(
    touched: TouchedSheet,
    metric: Metric,
    surface: FittedSurface | None,
    doubts: Doubts,
    skin: Skin = PAPER,
) -> Unseen:
    """Return what may differ on a deformation.

    Args:
        touched: Its sheet.
        metric: The sheet's.
        surface: The fitted one, for what noise does to it; None for a metric that no scan gave.
        doubts: How much may differ.
        skin: Whose sheet.
    """
    sheet = touched.sheet
    mesh = sheet.system.mesh
    at = mesh.centres_mm
    E, F, G = metric(at).T
    ratio = mesh.sizes_mm[:, 1] / mesh.sizes_mm[:, 0]
    sigma = sheet.system.background * sheet.system.relative
    scale = sigma * sheet.system.thickness_mm * MM / (E * G - F**2)
    power = powers(touched)
    tensor = scale * np.array([G * ratio, -F, E / ratio])  # (3, e)

    def answer(dE: Array, dF: Array, dG: Array) -> Array:
        """Return (104, m) V for changes (e, m) of the metric."""
        shrink = -(dE * G[:, None] + E[:, None] * dG - 2.0 * F[:, None] * dF) / (E * G - F**2)[:, None]
        parts = (
            scale[:, None] * ratio[:, None] * dG + tensor[0][:, None] * shrink,
            -scale[:, None] * dF + tensor[1][:, None] * shrink,
            scale[:, None] / ratio[:, None] * dE + tensor[2][:, None] * shrink,
        )
        return np.asarray(sum(one.T @ part for one, part in zip(power, parts, strict=True)).T).T

    by_log_sigma = np.einsum("ce,cer->er", tensor, power)
    waves = waves_of(skin, doubts.stretch)
    along, across = waves.along(at), waves.across(at)
    nil = np.zeros((len(at), across.shape[1]))
    u, v = np.concatenate([along, nil], axis=1), np.concatenate([np.zeros_like(along), across], axis=1)
    stretch = answer(2.0 * E[:, None] * u, F[:, None] * (u + v), 2.0 * G[:, None] * v) * waves.sd
    length, width = skin.outline.size_mm
    x, y = at.T
    fields = {
        "drift": (np.ones(len(at)), doubts.drift),
        "tilt x": (np.sqrt(12.0) * (x / length - 0.5), doubts.tilt),
        "tilt y": (np.sqrt(12.0) * (y / width - 0.5), doubts.tilt),
        "gauge": (-0.5 * np.log(E * G - F**2), doubts.gauge),
    }
    layer = np.array([by_log_sigma.T @ (size * one) for one, size in fields.values()]).T
    parts = [stretch, layer]
    if surface is not None and doubts.scan_mm > 0.0:
        parts.append(answer(*_scans(surface, at, doubts.scan_mm, skin)))
    return Unseen((*waves.names, *fields), np.concatenate(parts, axis=1), waves, by_log_sigma)


def _scans(surface: FittedSurface, at: Array, noise_mm: float, skin: Skin) -> tuple[Array, Array, Array]:
    """Return (e, draws) changes of E, F and G by a scanner's noise, over the root of their number."""
    rng = np.random.default_rng(SEED)
    by_x, by_y = surface.tangents(at)
    found = []
    for _ in range(DRAWS):
        noise = noise_mm * rng.standard_normal((3, *skin.grid.shape))
        dx, dy = fit_cloud(noise, skin.grid).tangents(at)
        found.append([2.0 * np.sum(by_x * dx, 1), np.sum(by_x * dy + by_y * dx, 1), 2.0 * np.sum(by_y * dy, 1)])
    dE, dF, dG = np.moveaxis(np.array(found), 0, -1) / np.sqrt(DRAWS)
    return dE, dF, dG
