"""What touches off the unit grid should read on one scanned deformation, and what the model does not know of it.

dV is against the flat reference, as the runtime's: V over the model's own flat sheet on the same mesh, less 1, so that
the mesh's error and the current drop out. Where a frame says that the sheet is stretched otherwise than the scan shows,
or conducts otherwise where it is stretched, by more than a derivative is good for, the model is made again about that:
:meth:`Model.about`.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.freeform.sheet import assembled_metric
from eitskin_sim.scene.nominal import flat_metric_of, nominal_sheet
from eitskin_sim.scene.touch_table import Array
from eitskin_sim.shapes.sheet import Solved, TouchedSheet
from eitskin_sim.surface.predict import FittedSurface, fit_cloud
from eitskin_sim.verification.free.unseen import Unseen, unseen
from eitskin_sim.verification.residual import Noise, Whitener
from eitskin_sim.verification.scan_noise import scan_noise_mm
from eitskin_sim.verification.spreads import Spreads, usual

ELEMENT_MM: Final = 4.5
"""The largest element: fitted centres are off by up to 0.1 mm by it, sizes by 0.2 mm."""

FLOOR: Final = 1e-3
"""Of V over V0: what is left of the mesh's error."""

TRUSTED: Final = 0.02
"""Stretch up to which a derivative is good enough."""

TRUSTED_GAUGE: Final = 0.2
"""Gauge factor up to which it is."""

LIKELY: Final = 2.0
"""Standard deviations, by root mean square, up to which a frame is believed on how the sheet is stretched."""


RATIO: Final = (0.3, 3.0)
"""Bounds of a frame's V over the untouched model's, by which what is unseen is scaled row by row."""


@lru_cache(maxsize=4)
def flat_model_V(skin: Skin) -> Array:
    """Return the (104,) V of the flat sheet on the model's mesh."""
    return _touched(flat_metric_of(skin), skin).untouched_V


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """One deformation, ready for touches."""

    touched: TouchedSheet
    metric: Metric
    surface: FittedSurface
    unseen: Unseen
    flat_V: Array
    """(104,) of the model's flat sheet."""
    spreads: Spreads
    skin: Skin
    held: Array
    """(k,) amplitudes of the first columns, waves and layer, that the model has already."""

    @property
    def untouched(self) -> Array:
        """(104,) dV with nothing touched."""
        return np.asarray(self.touched.untouched_V / self.flat_V - 1.0)

    def solve(self, pieces: Array) -> tuple[Solved, Array]:
        """Return a touch set solved, and its (104,) dV."""
        solved = self.touched.solve(pieces)
        return solved, self.seen(solved)

    def seen(self, solved: Solved) -> Array:
        """Return the (104,) dV of a touch set that was solved."""
        return np.asarray(solved.voltages_V / self.flat_V - 1.0)

    def jacobian(self, solved: Solved, free: npt.NDArray[np.bool_]) -> Array:
        """Return (104, r) dV by the free parameters."""
        return np.asarray(self.touched.jacobian(solved, free)[0] / self.flat_V[:, None])

    def whitener(self, change: Array, reference: Array, noise: Noise) -> Whitener:
        """Return the whitener of a frame (104,) dV against a reference (104,) V."""
        columns = self.unseen.columns / self.flat_V[:, None] * self.ratio(change)[:, None]
        return Whitener(noise.sd(change, reference), columns, 1.0 + change, floor=FLOOR)

    def expected(self, ratio: Array) -> Array:
        """Return (104,) dV that is expected of a frame beside the touches: what the model has is unlikely.

        What the model has already was believed of one frame; before any it is none.

        Args:
            ratio: (104,) of the frame's voltages over the untouched sheet's.
        """
        held = self.unseen.columns[:, : len(self.held)] @ self.held
        return np.asarray(-held / self.flat_V * ratio)

    def ratio(self, change: Array) -> Array:
        """Return (104,) a frame's voltages over the untouched sheet's, within bounds."""
        return np.clip(np.abs((1.0 + change) / (1.0 + self.untouched)), *RATIO)

    def beyond(self, amplitudes: Array) -> tuple[Array, float]:
        """Return (w,) the waves that amplitudes of all columns say, less those that the model has; and so its gauge."""
        own = amplitudes[: len(self.held)] - self.held
        return np.asarray(self.unseen.mixed @ own[: self.unseen.n_waves]), self._gauge(own)

    def differs(self, amplitudes: Array) -> bool:
        """Return whether the sheet is stretched, or conducts, otherwise by more than a derivative is good for.

        Args:
            amplitudes: Of all columns. What a sheet is not likely to have is nonsense: a model of it would spoil the
                frames after it.
        """
        waves, gauge = self.beyond(amplitudes)
        near = np.abs(waves).max(initial=0.0) < TRUSTED and abs(gauge) < TRUSTED_GAUGE
        own = amplitudes[: len(self.held)]
        return not near and bool(own @ own < LIKELY**2 * len(own))

    def about(self, amplitudes: Array) -> "Model":
        """Return the model of the sheet with the waves and the gauge factor of some amplitudes of all columns."""
        held, waves = np.zeros(len(self.held)), self.unseen.n_waves
        for kept in (slice(waves), waves + self.unseen.names.index("gauge")):
            held[kept] = amplitudes[kept]
        moved = self.unseen.waves.moved(self.surface.metric, self.unseen.mixed @ held[:waves])
        return _model(moved, self.surface, self.spreads, self.skin, held, self._gauge(held))

    def looser(self, factor: float) -> "Model":
        """Return the model of the scan alone, with material that may lie so many times as far from where it seems."""
        spreads = replace(self.spreads, material=factor * self.spreads.material)
        return _model(self.surface.metric, self.surface, spreads, self.skin)

    def _gauge(self, held: Array) -> float:
        """Return the gauge factor of amplitudes of the first columns."""
        return float(self.spreads.gauge * held[self.unseen.n_waves + self.unseen.names.index("gauge")])


def model_of_cloud(cloud_mm: npt.ArrayLike, skin: Skin = PAPER, spreads: Spreads | None = None) -> Model:
    """Return the model of a scanned deformation.

    Args:
        cloud_mm: (3, rows, columns) mm.
        skin: Whose sheet.
        spreads: How much may differ; None is what the skin says. A scan that shows more noise has more.

    Raises:
        ValueError: The cloud is malformed, or folds in its own plane.
    """
    surface, known = fit_cloud(cloud_mm, skin.grid), spreads or usual(skin)
    if known.scan_mm:
        known = replace(known, scan_mm=max(known.scan_mm, scan_noise_mm(cloud_mm, surface, skin.grid)))
    return _model(surface.metric, surface, known, skin)


def _model(
    metric: Metric,
    surface: FittedSurface,
    spreads: Spreads,
    skin: Skin,
    held: Array | None = None,
    gauge: float = 0.0,
) -> Model:
    sheet = _touched(metric, skin, gauge)
    found = unseen(sheet, metric, surface, spreads, skin, nominal_sheet(skin).gauge_factor + gauge)
    own = np.zeros(found.n_waves + len(found.names)) if held is None else held
    return Model(sheet, metric, surface, found, flat_model_V(skin), spreads, skin, own)


def _touched(metric: Metric, skin: Skin, gauge: float = 0.0) -> TouchedSheet:
    assembled = assembled_metric(metric, ELEMENT_MM, skin=skin, gauge=gauge)
    return TouchedSheet(assembled, shared_mesh(ELEMENT_MM, None, skin))
