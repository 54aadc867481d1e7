"""What touches should read on one scanned deformation, and what the model does not know of it.

dV is against the flat reference, as the runtime's: V over the model's own flat sheet on the same mesh, less 1, so that
the mesh's error and the current drop out. Where a frame says that the sheet is stretched otherwise than the scan shows,
or conducts otherwise where it is stretched, by more than a derivative is good for, the model is made again about that:
:meth:`Model.about`. Frames of the untouched sheet say so best, and what the model lacks besides: :meth:`Model.rested`.
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
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.surface.smoothed import Scan, exact, smoothed
from eitskin_sim.verification.residual import Noise, Rows, Whitener
from eitskin_sim.verification.sheet.at_rest import MOST_SCALE, AtRest, at_rest
from eitskin_sim.verification.sheet.scan_noise import scan_noise_mm
from eitskin_sim.verification.sheet.spreads import Spreads, usual
from eitskin_sim.verification.sheet.unseen import Unseen, unseen
from eitskin_sim.verification.sheet.usual_waves import Lying, usual_waves
from eitskin_sim.verification.sheet.waves import waves_of

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

ROUGH: Final = 3.0
"""Times that a row is believed to be off by, of what a residual has more than it should."""

ROUNDS: Final = 8
"""Times that a model is made again about what the untouched sheet reads, at most."""

LOOSER: Final = 4.0
"""Times that material may lie farther, on a sheet that nothing explained."""

UNLIKE: Final = 1.2
"""Times that more is off at rest than was thought, before a looser sheet is tried,"""

LIKER: Final = 0.7
"""which has to leave this part of it at most."""

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
    scan: Scan
    lying: Lying
    unseen: Unseen
    flat_V: Array
    """(104,) of the model's flat sheet."""
    spreads: Spreads
    skin: Skin
    held: Array
    """(k,) amplitudes of the first columns, waves and layer, that the model has already."""
    rest: AtRest | None = None
    """What is known of the sheet since it was seen untouched; None before."""

    @property
    def gauge(self) -> float:
        """The gauge factor that the model has beside its skin's."""
        return self._gauge(self.held)

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

    def whitener(
        self,
        change: Array,
        reference: Array,
        noise: Noise,
        rough: float = 1.0,
        rows: Rows | None = None,
        own: Array | None = None,
    ) -> Whitener:
        """Return the whitener of a frame.

        Args:
            change: (104,) dV that it reads.
            reference: (104,) V.
            noise: Of the frame.
            rough: Times that the model is as rough as it is.
            rows: (104,) which rows there are; None is all.
            own: (104,) dV that each row may be off by besides, alone; None is none.
        """
        columns, sd = self._columns() * self.ratio(change)[:, None], noise.sd(change, reference)
        floor = FLOOR if self.rest is None else FLOOR * self.rest.scale
        return Whitener(sd if own is None else np.hypot(sd, own), columns, 1.0 + change, rows, rough * floor)

    def roughly(
        self, change: Array, residual: Array, reference: Array, noise: Noise, rows: Rows | None = None
    ) -> Array:
        """Return the amplitudes of all columns that a frame's residual speaks for, rows not explained believed less.

        Far from the truth no column explains a residual, and all that try go astray. What is left of it shows once the
        model is made about these amplitudes.

        Args:
            change: (104,) dV of the frame.
            residual: (104,) dV of it that nothing else explains.
            reference: (104,) V.
            noise: Of the frame.
            rows: (104,) which rows there are; None is all.
        """
        white = self.whitener(change, reference, noise, rows=rows)
        misfit = max(float(white.chi_squared(residual)) / len(white) - 1.0, 0.0)
        rough = float(np.sqrt(1.0 + ROUGH**2 * misfit))
        return self.whitener(change, reference, noise, rough, rows).amplitudes(residual)[0]

    def _columns(self) -> Array:
        """Return the (104, m) dV that may differ, of one standard deviation each, on the untouched sheet."""
        return self.unseen.columns / self.flat_V[:, None] if self.rest is None else self.rest.columns

    def expected(self, ratio: Array) -> Array:
        """Return (104,) dV that is expected of a frame beside the touches: what the model has is unlikely.

        What the model has already was believed of one frame; before any it is none. What the sheet read at rest beside
        its model it still does.

        Args:
            ratio: (104,) of the frame's voltages over the untouched sheet's.
        """
        if self.rest is not None:
            return np.asarray(self.rest.beside * ratio)
        held = self.unseen.columns[:, : len(self.held)] @ self.held
        return np.asarray(-held / self.flat_V * ratio)

    def ratio(self, change: Array) -> Array:
        """Return (104,) a frame's voltages over the untouched sheet's, within bounds."""
        untouched = self.untouched if self.rest is None else self.rest.change
        return np.clip(np.abs((1.0 + change) / (1.0 + untouched)), *RATIO)

    def beyond(self, amplitudes: Array) -> tuple[Array, float]:
        """Return (w,) the waves that amplitudes of all columns say, less those that the model has; and so its gauge."""
        own = amplitudes[: len(self.held)] - self.held
        return np.asarray(self.unseen.mixed @ own[: self.unseen.n_waves]), self._gauge(own)

    def differs(self, amplitudes: Array) -> bool:
        """Return whether amplitudes of all columns say that the sheet is likely another, farther than derivatives go.

        What a sheet is not likely to have is nonsense: a model of it would spoil the frames after it.
        """
        return self.likely_share(amplitudes) == 1.0

    def likely_share(self, amplitudes: Array) -> float:
        """Return how far a sheet is likely to be on the way to some amplitudes of all columns; 0 where it is there.

        Far from the truth derivatives point beyond it. What is known of a sheet that was seen at rest is not asked.
        """
        if self.rest is not None or not self._far(amplitudes):
            return 0.0
        return 1.0 / max(1.0, float(np.sqrt(np.mean(np.square(amplitudes[: len(self.held)])))) / LIKELY)

    def _far(self, amplitudes: Array) -> bool:
        """Return whether amplitudes of all columns are farther from the model than a derivative is good for."""
        waves, gauge = self.beyond(amplitudes)
        return bool(np.abs(waves).max(initial=0.0) >= TRUSTED) or abs(gauge) >= TRUSTED_GAUGE

    def rested(self, change: Array, reference: Array, noise: Noise) -> "Model | None":
        """Return the model of the sheet that reads this while nothing touches it; None where it is another sheet.

        Nothing else explains what it reads, so stretch and gauge are believed whatever they are. Where they do not
        suffice, material may lie farther from where its scan shows it.

        Args:
            change: (104,) dV, the mean of some frames.
            reference: (104,) V.
            noise: Of that mean.
        """
        begun = self
        if self.lying.at_rest is not self.lying.ways:
            begun = _model(self.scan, replace(self.lying, ways=self.lying.at_rest), self.spreads, self.skin)
        scale, found = begun._rested(change, reference, noise)
        if scale > UNLIKE:
            other, looser = self.looser(LOOSER)._rested(change, reference, noise)
            if other < LIKER * scale:
                scale, found = other, looser
        return found if scale <= MOST_SCALE else None

    def _rested(self, change: Array, reference: Array, noise: Noise) -> "tuple[float, Model]":
        """Return times that more is off at rest than was thought, and the model about what the sheet reads then."""
        model = self
        for left in reversed(range(ROUNDS + 1)):
            ratio = model.ratio(change)
            beside, expected = change - model.untouched, model.expected(ratio)
            amplitudes = model.roughly(change, beside - expected, reference, noise)
            if not left or not model._far(amplitudes):
                break
            if (other := model.about(amplitudes)) is None:
                break
            model = other
        columns = model._columns() * ratio[:, None]
        rest = at_rest(change, beside, expected, columns, FLOOR * (1.0 + change), noise.sd(change, reference))
        return rest.scale, replace(model, rest=rest)

    def about(self, amplitudes: Array, share: float = 1.0) -> "Model | None":
        """Return the model with waves and gauge factor of amplitudes of all columns, or a share of the way there.

        None is returned where no sheet is so: its stiffness would not be positive.
        """
        held, waves = np.zeros(len(self.held)), self.unseen.n_waves
        for kept in (slice(waves), waves + self.unseen.names.index("gauge")):
            held[kept] = self.held[kept] + share * (amplitudes[kept] - self.held[kept])
        try:
            return _model(self.scan, self.lying, self.spreads, self.skin, held, self._gauge(held))
        except (ValueError, np.linalg.LinAlgError):
            return None

    def looser(self, factor: float) -> "Model":
        """Return the model of the scan alone, with material that may lie so many times as far from where it seems."""
        spreads = replace(self.spreads, material=factor * self.spreads.material)
        return _model(self.scan, usual_waves(self.skin).anyhow(), spreads, self.skin)

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
    scan = exact(surface, skin.grid)
    if known.scan_mm:
        scan = smoothed(surface, max(known.scan_mm, scan_noise_mm(cloud_mm, surface, skin.grid)), skin.grid)
    return _model(scan, usual_waves(skin).under(scan), known, skin)


def _model(
    scan: Scan, lying: Lying, spreads: Spreads, skin: Skin, held: Array | None = None, gauge: float = 0.0
) -> Model:
    """Return the model of a scan about amplitudes of its first columns; None of them is none."""
    ways = spreads.material * lying.ways
    own = np.zeros(ways.shape[1]) if held is None else held[: ways.shape[1]]
    metric = waves_of(skin).moved(scan.surface.metric, lying.mean + ways @ own)
    sheet = _touched(metric, skin, gauge)
    found = unseen(sheet, metric, scan, ways, spreads, skin, nominal_sheet(skin).gauge_factor + gauge)
    if held is None:
        held = np.zeros(found.n_waves + len(found.names))
    return Model(sheet, metric, scan, lying, found, flat_model_V(skin), spreads, skin, held)


def _touched(metric: Metric, skin: Skin, gauge: float = 0.0) -> TouchedSheet:
    assembled = assembled_metric(metric, ELEMENT_MM, skin=skin, gauge=gauge)
    return TouchedSheet(assembled, shared_mesh(ELEMENT_MM, None, skin))
