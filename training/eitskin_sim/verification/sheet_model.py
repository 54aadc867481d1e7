"""Models the voltages of touches on one scanned deformation, with the model's uncertainty.

dV is against the flat reference, as the runtime's: V over the model's own flat sheet on the same mesh, less 1, so that
the mesh's error and the current drop out. The sheet's deviations are linear, in columns of one standard deviation each
(:mod:`eitskin_sim.verification.unseen`). If a frame shows that the sheet's stretch or its effect on conductivity
differs from the scan beyond the range of the derivatives, the model is made again there: :meth:`SheetModel.about`.
Untouched frames show this best, and other errors of the model too: :meth:`SheetModel.rested`.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.freeform.sheet import assembled_metric
from eitskin_sim.scene.nominal import flat_metric_of, nominal_sheet
from eitskin_sim.shapes.sheet import Solved, TouchedSheet
from eitskin_sim.surface.predict import FittedSurface, fit_cloud
from eitskin_sim.surface.smoothed import smoothed
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.at_rest import AtRest, at_rest
from eitskin_sim.verification.metric_family import metric_family
from eitskin_sim.verification.residual import Noise, Rows, Whitener
from eitskin_sim.verification.scanned_member import member_of
from eitskin_sim.verification.unseen import Shape, Unseen, unseen
from eitskin_sim.verification.usual_waves import ScannedShape, usual_waves
from eitskin_sim.verification.waves import waves_of


@lru_cache(maxsize=4)
def flat_model_V(skin: Skin) -> Array:
    """Return the (104,) V of the flat sheet on the model's mesh."""
    return touched_sheet(flat_metric_of(skin), skin).untouched_V


@dataclass(frozen=True, slots=True, eq=False)
class SheetModel:
    """One deformation, ready for touches."""

    touched: TouchedSheet
    metric: Metric
    shape: Shape
    unseen: Unseen
    flat_V: Array
    """(104,) of the model's flat sheet."""
    skin: Skin
    held: Array
    """(k,) amplitudes of the first columns, waves and layer, that the model has already."""
    rest: AtRest | None = None
    """The findings from the untouched sheet; None before."""

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
        return solved, self.change(solved)

    def change(self, solved: Solved) -> Array:
        """Return the (104,) dV of a touch set that was solved."""
        return np.asarray(solved.voltages_V / self.flat_V - 1.0)

    def jacobian(self, solved: Solved, fitted: npt.NDArray[np.bool_]) -> Array:
        """Return (104, r) dV by the fitted parameters."""
        return np.asarray(self.touched.jacobian(solved, fitted)[0] / self.flat_V[:, None])

    def whitener(
        self,
        change: Array,
        reference: Array,
        noise: Noise,
        rows: Rows | None = None,
        own: Array | None = None,
        floor_factor: float = 1.0,
    ) -> Whitener:
        """Return the whitener of a frame.

        Args:
            change: (104,) dV that it reads.
            reference: (104,) V.
            noise: Of the frame.
            rows: (104,) which rows there are; None is all.
            own: (104,) additional independent error of each row in dV; None is none.
            floor_factor: Factor of each row's error over the mesh's error.
        """
        columns, sd = self._columns() * self.ratio(change)[:, None], noise.sd(change, reference)
        if noise.shared is not None:
            columns = np.hstack([columns, noise.shared])
        floor = c.MESH_ERROR * floor_factor * (1.0 if self.rest is None else self.rest.scale)
        return Whitener(sd if own is None else np.hypot(sd, own), columns, 1.0 + change, rows, floor)

    def amplitudes(
        self, change: Array, residual: Array, reference: Array, noise: Noise, rows: Rows | None = None
    ) -> Array:
        """Return the amplitudes of all columns that a frame's residual speaks for.

        Far from the truth no column explains a residual, and all that try go astray. So the more of it is unexplained,
        the less its rows are believed; what is left shows once the model is made about these amplitudes.

        Args:
            change: (104,) dV of the frame.
            residual: (104,) dV of it that nothing else explains.
            reference: (104,) V.
            noise: Of the frame.
            rows: (104,) which rows there are; None is all.
        """
        white = self.whitener(change, reference, noise, rows)
        misfit = max(float(white.chi_squared(residual)) / len(white) - 1.0, 0.0)
        if misfit:
            factor = float(np.sqrt(1.0 + c.ROW_ERROR_PER_MISFIT**2 * misfit))
            white = self.whitener(change, reference, noise, rows, floor_factor=factor)
        return white.amplitudes(residual)[: self._columns().shape[1]]

    def _columns(self) -> Array:
        """Return the (104, m) dV that may differ, of one standard deviation each, on the untouched sheet."""
        return self.unseen.columns / self.flat_V[:, None] if self.rest is None else self.rest.columns

    def expected(self, ratio: Array) -> Array:
        """Return (104,) dV that the prior expects of a frame in addition to its touches.

        A model that was made again about one frame's sheet expects the way back to the scan; the first model expects
        none. A deviation that the sheet showed at rest persists.

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
        return np.clip(np.abs((1.0 + change) / (1.0 + untouched)), *c.VOLTAGE_RATIO_BOUNDS)

    def beyond(self, amplitudes: Array) -> tuple[Array, float]:
        """Return (w,) stretches and the gauge factor that amplitudes of all columns say, less those of the model."""
        own = amplitudes[: len(self.held)] - self.held
        return np.asarray(self.shape.stretch @ own[: self.unseen.n_waves]), self._gauge(own)

    def is_far(self, amplitudes: Array) -> bool:
        """Return whether amplitudes of all columns are farther from the model than derivatives are good for."""
        waves, gauge = self.beyond(amplitudes)
        return bool(np.abs(waves).max(initial=0.0) >= c.MAX_LINEAR_STRETCH) or abs(gauge) >= c.MAX_LINEAR_GAUGE

    def likely_share(self, amplitudes: Array) -> float:
        """Return how far a sheet is likely to be on the way to some amplitudes of all columns: 1 is all the way."""
        rms = float(np.sqrt(np.mean(np.square(amplitudes[: len(self.held)]))))
        return 1.0 / max(1.0, rms / c.MAX_RMS_OF_LIKELY_SHEET)

    def about(self, amplitudes: Array, share: float = 1.0) -> "SheetModel | None":
        """Return the model with waves and gauge factor of amplitudes of all columns, or a share of the way there.

        None is returned where no sheet is so: its stiffness would not be positive.
        """
        held, waves = np.zeros(len(self.held)), self.unseen.n_waves
        for kept in (slice(waves), self._gauge_column):
            held[kept] = self.held[kept] + share * (amplitudes[kept] - self.held[kept])
        try:
            return _model(self.shape, self.skin, held, self._gauge(held))
        except (ValueError, np.linalg.LinAlgError):
            return None

    def rested(self, change: Array, reference: Array, noise: Noise) -> "SheetModel | None":
        """Return the model of the sheet that reads this while nothing touches it; None where it is another sheet.

        Nothing else explains what it reads, so stretch and gauge are believed whatever they are.

        Args:
            change: (104,) dV, the mean of some frames.
            reference: (104,) V.
            noise: Of that mean.
        """
        shape = self.shape.at_rest()
        model = self if shape is self.shape else _model(shape, self.skin)
        for left in reversed(range(c.MAX_MODELS_AT_REST + 1)):
            ratio = model.ratio(change)
            beside, expected = change - model.untouched, model.expected(ratio)
            amplitudes = model.amplitudes(change, beside - expected, reference, noise)
            if not left or not model.is_far(amplitudes) or (other := model.about(amplitudes)) is None:
                break
            model = other
        columns, floor = model._columns() * ratio[:, None], c.MESH_ERROR * (1.0 + change)
        rest = at_rest(change, beside, expected, columns, floor, noise.covariance(change, reference))
        return replace(model, rest=rest) if rest.scale <= c.MAX_EXCESS_AT_REST else None

    @property
    def _gauge_column(self) -> int:
        return self.unseen.n_waves + self.unseen.names.index("gauge")

    def _gauge(self, held: Array) -> float:
        """Return the gauge factor of amplitudes of the first columns."""
        return float(c.GAUGE_SD * held[self._gauge_column])


def model_of_cloud(cloud_mm: npt.ArrayLike, skin: Skin = PAPER, *, may_be_other: bool = False) -> SheetModel:
    """Return the model of a scanned deformation.

    Args:
        cloud_mm: (3, rows, columns) mm.
        skin: Whose sheet.
        may_be_other: Whether it may be another shape of its skin's family. A noisy scan is then evidence of a member of
            the family, by its doubt.

    Raises:
        ValueError: The cloud is malformed, or folds in its own plane.
    """
    surface, stated_mm = fit_cloud(cloud_mm, skin.grid), skin.may_be_off.scan_noise_mm[0] or c.SCAN_NOISE_MM
    noise_mm = max(stated_mm, scan_noise_mm(cloud_mm, surface, skin.grid))
    scan = smoothed(surface, noise_mm, skin.grid)
    scanned = ScannedShape(scan, waves_of(skin), usual_waves(skin).under(scan))
    member = member_of(metric_family(skin), scanned) if may_be_other and noise_mm > c.GOOD_SCAN_MM else None
    return _model(member or scanned, skin)


def model_without_scan(skin: Skin = PAPER) -> SheetModel:
    """Return the model of the skin's usual deformation, whose own shape is anything of the family.

    Raises:
        ValueError: The skin has no family.
    """
    return _model(metric_family(skin), skin)


def scan_noise_mm(cloud_mm: npt.ArrayLike, surface: FittedSurface, grid: Grid = PAPER.grid) -> float:
    """Return the standard deviation of a scan's points along each direction of space, as the scan itself shows it.

    A scanner may be worse than the skin says, and a surface rougher than the spline can follow. Both misplace the
    model, and both show as points that lie off the smooth surface. A spline of n coefficients takes its part of the
    noise with it, which is put back: noise^2 = sum of squared distances / (3 (points - n)).

    Args:
        cloud_mm: (3, rows, columns) mm.
        surface: Fitted to it.
        grid: Of the cloud.
    """
    points = surface.points(grid.pixel_centres_mm().reshape(-1, 2))
    off = np.asarray(cloud_mm, dtype=np.float64).reshape(3, -1).T - points
    free = max(len(points) - surface.coefficients[..., 0].size, 1)
    return float(min(np.sqrt(np.sum(off**2) / (3 * free)), c.MAX_SCAN_NOISE_MM))


def _model(shape: Shape, skin: Skin, held: Array | None = None, gauge: float = 0.0) -> SheetModel:
    """Return the model of a shape about amplitudes of its first columns; None of them is none."""
    count = shape.stretch.shape[1]
    own = np.zeros(count) if held is None else held[:count]
    metric = shape.metric(own)
    sheet = touched_sheet(metric, skin, gauge)
    found = unseen(sheet, metric, shape, own, skin, nominal_sheet(skin).gauge_factor + gauge)
    if held is None:
        held = np.zeros(found.n_waves + len(found.names))
    return SheetModel(sheet, metric, shape, found, flat_model_V(skin), skin, held)


def touched_sheet(metric: Metric, skin: Skin, gauge: float = 0.0) -> TouchedSheet:
    """Return a sheet of some metric on the model's mesh, ready for touches."""
    assembled = assembled_metric(metric, c.ELEMENT_MM, skin=skin, gauge=gauge)
    return TouchedSheet(assembled, shared_mesh(c.ELEMENT_MM, None, skin))
