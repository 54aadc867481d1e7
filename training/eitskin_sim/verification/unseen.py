"""Linear differences between the sheet and the model of its scan, on one deformation, from one factorisation.

The model has the metric of a smooth surface through the scanned points. A scan without marks divides rows and columns
by arc length, so it misses how stretch is distributed along them; and noise makes the surface uncertain. Both change
the conductance tensor K = sigma t0 g^-1 of every element, and so do conductivities that drifted. With the fields X of
the untouched sheet every such change answers as

    dU = - sum over elements of X_e^T dS_e X_e,      dS_e = dK_xx S_xx + dK_xy S_xy + dK_yy S_yy

so the three powers of every element are computed once, and a change costs one small product. ::

    stretch     displacements of the material under the scan's points: waves along x and y, none across the border
    scan        the uncertainty of the surface from the scanner's noise, in all its modes
    drift       of the whole layer's conductivity since the reference
    tilt x, y   drift that differs from end to end, a plane of rms 1
    gauge       conductivity goes with (local area stretch)^-k
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.borders.enrichment import PRODUCTS
from eitskin_sim.fem.mesh import MM, Metric
from eitskin_sim.freeform.mesh import KEPT_NODES, MIDDLE_NODE, with_contacts
from eitskin_sim.shapes.sheet import TouchedSheet
from eitskin_sim.verification import constants as c


class Shape(Protocol):
    """What is known of a sheet's shape: metrics by amplitudes of standard deviation 1, and what is unsure beside them.

    A scan gives the metric of its surface, with displacements of the material; without one, it is a member of the
    skin's family.
    """

    @property
    def stretch(self) -> Array:
        """(w, k) stretches by each of the k amplitudes."""

    def metric(self, amplitudes: Array) -> Metric:
        """Return the metric at (k,) amplitudes."""

    def rates(self, amplitudes: Array, metric: Metric, xy_mm: Array) -> tuple[Array, Array, Array]:
        """Return the (3, n, k) derivatives of E, F and G at flat points (n, 2) by amplitudes, and by other errors.

        These are (3, n, e) by e parts, and their (e, m) mixtures of one standard deviation each.
        """

    def at_rest(self) -> "Shape":
        """Return the shape as it is known where the untouched sheet decides."""


@dataclass(frozen=True, slots=True)
class Unseen:
    """All changes of one deformation."""

    names: tuple[str, ...]
    """Of those after the shape's; the scans' come last and have no names."""
    columns: Array
    """(104, m) V for one standard deviation of each, under 1 A, untouched."""
    by_log_sigma: Array
    """(n_elements, 104) V by log conductivity of each element, untouched."""
    n_waves: int
    """How many columns are amplitudes of the shape; those of the layer follow, by ``names``."""


def _powers(touched: TouchedSheet) -> Array:
    """Return (3, n_elements, 104): - X_e^T S_c X_e for the xx, xy and yy parts, untouched."""
    sheet, grid = touched.sheet, touched.grid
    elements = np.arange(len(sheet.before))
    contacts = sheet.system.contacts
    density = contacts.density(np.full(len(contacts.element), sheet.system.background))
    whole = with_contacts(sheet.system.background * sheet.system.stiffness, elements, density, contacts)
    driven = touched.to_terminals - np.roll(touched.to_terminals, -1, axis=1)
    outer = np.concatenate([driven, np.zeros((1, 16))])[grid.dofs]  # (e, 9, 16), the electrode last
    middle = (
        -(whole[:, MIDDLE_NODE, KEPT_NODES][:, None, :] @ outer) / whole[:, MIDDLE_NODE, MIDDLE_NODE][:, None, None]
    )
    fields = np.insert(outer[:, :8], MIDDLE_NODE, middle[:, 0], axis=1)
    tables = PRODUCTS.sum(axis=0).reshape(3, 9, 9)
    flipped, (drive, measure) = np.swapaxes(fields, 1, 2), TABLE.T.astype(np.intp)
    return np.array([-(flipped @ (table @ fields))[:, drive, measure] for table in tables])


def unseen(touched: TouchedSheet, metric: Metric, shape: Shape, amplitudes: Array, skin: Skin, gauge: float) -> Unseen:
    """Return the possible differences on a deformation.

    Args:
        touched: Its sheet.
        metric: The sheet's.
        shape: What is known of it.
        amplitudes: (k,) of the shape, at which it has this metric.
        skin: Whose sheet.
        gauge: k of its model, where conductivity goes by (area stretch)^-k: it follows what changes the stretch.
    """
    sheet = touched.sheet
    mesh = sheet.system.mesh
    at = mesh.centres_mm
    first = metric(at)
    E, F, G = first.T
    ratio = mesh.sizes_mm[:, 1] / mesh.sizes_mm[:, 0]
    sigma = sheet.system.background * sheet.system.relative
    scale = sigma * sheet.system.thickness_mm * MM / (E * G - F**2)
    power = _powers(touched)
    tensor = scale * np.array([G * ratio, -F, E / ratio])  # (3, e)

    by_log_sigma = np.einsum("ce,cer->er", tensor, power)
    stretch = (1.0 + gauge / 2.0) / (E * G - F**2)  # by how much the area's stretch shrinks all of K
    by_metric = np.array(
        [
            power[2] * (scale / ratio)[:, None] - by_log_sigma * (stretch * G)[:, None],
            by_log_sigma * (2.0 * stretch * F)[:, None] - power[1] * scale[:, None],
            power[0] * (scale * ratio)[:, None] - by_log_sigma * (stretch * E)[:, None],
        ]
    )  # (3, e, 104) V by E, F and G of each element
    *rates, mixed = shape.rates(amplitudes, metric, at)
    own, noise = (np.tensordot(by_metric, one, ((0, 1), (0, 1))) for one in rates)
    fields = _layer_fields(at, first, skin)
    layer = np.array([by_log_sigma.T @ (size * one) for one, size in fields.values()]).T
    columns = np.concatenate([own, layer, _strongest(noise @ mixed)], axis=1)
    return Unseen(tuple(fields), columns, by_log_sigma, own.shape[1])


def _strongest(columns: Array) -> Array:
    """Return (104, m) columns of nearly the same covariance, as few as do."""
    if not columns.size:
        return columns
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    kept = int(np.sum(size > c.MIN_SCAN_WAY_SHARE * size.max(initial=0.0)))
    return np.asarray(left[:, :kept] * size[:kept])


def _layer_fields(xy_mm: Array, metric: Array, skin: Skin) -> dict[str, tuple[Array, float]]:
    """Return by name (n,) changes of the layer's log conductivity, and the standard deviation of how much of each.

    Args:
        xy_mm: (n, 2) flat places.
        metric: (n, 3) E, F, G there.
        skin: Whose layer.
    """
    length, width = skin.outline.size_mm
    x, y = xy_mm.T
    E, F, G = metric.T
    return {
        "drift": (np.ones(len(xy_mm)), c.DRIFT_SD),
        "tilt x": (np.sqrt(12.0) * (x / length - 0.5), c.TILT_SD),
        "tilt y": (np.sqrt(12.0) * (y / width - 0.5), c.TILT_SD),
        "gauge": (-0.5 * np.log(E * G - F**2), c.GAUGE_SD),
    }
