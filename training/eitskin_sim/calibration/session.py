"""A whole recording: the reference, bent moments with their scans, presses of a stamp; all in units of noise.

Later moments are relative to the reference, dV = V / V0 - 1, so that static errors cancel. In addition to noise a
moment may have drifted by ``DRIFT`` since the reference, common to its rows, with a tenth of it uneven. A bent one has
the error of its scan (:mod:`eitskin_sim.calibration.bends`), a press a relative error of ``PRESS_ERROR``.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.calibration import stamp as stamps
from eitskin_sim.calibration.bends import bend_error
from eitskin_sim.calibration.fit import MISFIT_LEVEL, CalibrationError
from eitskin_sim.calibration.model import GAUGE, Model, ModelVoltages, SheetState
from eitskin_sim.calibration.recording import LaterReading, Recording, noise_V, of_table
from eitskin_sim.surface.predict import fit_cloud

DRIFT: Final = 0.01
"""Of real skins within a hundred presses."""

UNEVEN_DRIFT_SHARE: Final = 0.1
"""Share of a drift that is not common to all rows."""

PRESS_ERROR: Final = 0.03
"""Of a press's own change, row by row: elements of 3 mm, and no stamp's outline is exactly a disc or a rectangle."""


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """Something that was read after the reference."""

    name: str
    """For people."""
    read: LaterReading
    lying: SheetState
    covariance: Array
    """(104, 104) of dV, beside a press's own share."""
    expected: Array
    """(104,) what the model is off by on average."""
    by_gauge: Array
    """(104,) and by how much more for a gauge factor of 1."""
    allowed: float = 1.0
    """Times what chance allows a misfit of Gaussian errors."""


class Session:
    """All that was recorded of one sheet.

    Args:
        skin: The stated one.
        recording: The recording.
        snr_db: Of a single frame; None takes the least that the skin states.
        way: Which way presses change conductance, of :data:`eitskin_sim.calibration.stamp.WAYS`.
    """

    def __init__(self, skin: Skin, recording: Recording, snr_db: float | None = None, way: stamps.Way = -1) -> None:
        presses = recording.presses
        more = stamps.groups(skin.touches, way, len(presses)) if presses else []
        self.flat = Model(skin, recording, snr_db, more)
        self.way = way
        self.moments = [*self._bents(), *self._presses()]
        self._softness = 0.0

    @property
    def count(self) -> int:
        """How many parameters there are."""
        return self.flat.count

    @property
    def blocks(self) -> list[slice]:
        """Which residuals belong to the reference, and to every moment."""
        stops = np.cumsum([len(self.flat.recording.reference_V), *([N_ROWS] * len(self.moments))])
        starts = np.concatenate([[0], stops[:-1]])
        return [slice(int(low), int(high)) for low, high in zip(starts, stops, strict=True)]

    def inside(self, z: Array) -> Array:
        """Return the nearest (count,) parameters that a sheet can have."""
        return self.flat.inside(z)

    def soften(self, z: Array, error: float) -> None:
        """Take every row for uncertain by a share of it beside all else, from now on."""
        self.flat.soften(z, error)
        self._softness = error

    def residuals(self, z: Array) -> Array:
        """Return the (rows,) whitened residuals."""
        flat = self.flat.read(z, derivatives=False)
        parts = [self.flat.whitened(flat.voltages_V)]
        for moment in self.moments:
            factor, should = self._whitening(moment, flat, self.flat.read(z, moment.lying, derivatives=False))
            parts.append(self._left(moment, z, factor, should))
        return np.concatenate(parts)

    def linearised(self, z: Array) -> tuple[Array, Array]:
        """Return them, and the (rows, count) Jacobian of what should be read."""
        flat = self.flat.read(z, derivatives=True)
        first, rates = self.flat.whitened_with(flat)
        parts, jacobians = [first], [rates]
        for moment in self.moments:
            read = self.flat.read(z, moment.lying, derivatives=True)
            factor, should = self._whitening(moment, flat, read)
            assert flat.jacobian is not None
            assert read.jacobian is not None
            base = of_table(flat.voltages_V)[:, None]
            rate = (of_table(read.jacobian) - (1.0 + should)[:, None] * of_table(flat.jacobian)) / base
            if (gauge := self.flat.parameters.slices.get(GAUGE)) is not None:
                rate[:, gauge] += self.flat.parameters.groups[GAUGE].spread * moment.by_gauge[:, None]
            parts.append(self._left(moment, z, factor, should))
            jacobians.append(np.asarray(np.linalg.solve(factor, rate), dtype=np.float64))
        return np.concatenate(parts), np.concatenate(jacobians)

    def changed(self) -> float:
        """Return the mean square, over noise and drift, of what the press that is felt most changed."""
        presses = [(self._change(one), one.covariance) for one in self.moments if one.lying.touched_by]
        return max(float(change @ np.linalg.solve(covariance, change)) / len(change) for change, covariance in presses)

    def _whitening(self, moment: Moment, flat: ModelVoltages, read: ModelVoltages) -> tuple[Array, Array]:
        """Return the (104, 104) factor of what dV may be off by, and (104,) what it should be."""
        should = of_table(read.voltages_V) / of_table(flat.voltages_V) - 1.0
        covariance = moment.covariance
        own = self._softness**2 + float(moment.lying.at_reference) * PRESS_ERROR**2 * self._change(moment) ** 2
        return np.asarray(np.linalg.cholesky(covariance + np.diag(own * np.ones(len(should))))), np.asarray(should)

    def _left(self, moment: Moment, z: Array, factor: Array, should: Array) -> Array:
        """Return (104,) what was read less what should be, over what it may be off by."""
        expected = should + moment.expected + self.flat.parameters.one(GAUGE, z) * moment.by_gauge
        return np.asarray(np.linalg.solve(factor, self._change(moment) - expected), dtype=np.float64)

    def _change(self, moment: Moment) -> Array:
        return np.asarray(moment.read.voltages_V / of_table(self.flat.recording.reference_V) - 1.0)

    def _covariance(self, read: LaterReading) -> Array:
        """Return (104, 104) what noise and drift do to dV."""
        reference, frames = of_table(self.flat.recording.reference_V), self.flat.recording.frames
        skin, level = self.flat.skin, self.flat.level
        ratio = read.voltages_V / reference
        noise = (noise_V(skin, read.voltages_V, level, read.frames) / reference) ** 2
        noise += (ratio * noise_V(skin, reference, level, frames) / reference) ** 2
        return np.asarray(
            DRIFT**2 * np.outer(ratio, ratio) + np.diag(noise + (UNEVEN_DRIFT_SHARE * DRIFT * ratio) ** 2)
        )

    def _bents(self) -> list[Moment]:
        found = []
        for number, one in enumerate(self.flat.recording.bents):
            assert one.cloud_mm is not None
            error = bend_error(self.flat.skin)
            ratio = one.voltages_V / of_table(self.flat.recording.reference_V)
            covariance = self._covariance(one) + ratio[:, None] * error.covariance * ratio
            lying = SheetState(fit_cloud(one.cloud_mm, self.flat.skin.grid).metric, at_reference=False)
            more = ratio * error.steeper * self.flat.slope(lying)
            found.append(
                Moment(f"bent moment {number}", one, lying, covariance, ratio * error.mean, more, error.largest)
            )
        return found

    def _presses(self) -> list[Moment]:
        found = []
        parameters = self.flat.parameters
        for number, one in enumerate(self.flat.recording.presses):
            assert one.xy_mm is not None
            assert one.stamp_mm is not None
            touches = stamps.press(stamps.Stamp(one.stamp_mm), one.xy_mm, self.way, number, parameters)
            touched_by = stamps.own_parameters(parameters, number)
            lying = replace(self.flat.base, touches=touches, touched_by=touched_by)
            x, y = one.xy_mm
            name = f"press {number} at ({x:g}, {y:g}) mm"
            found.append(Moment(name, one, lying, self._covariance(one), *np.zeros((2, N_ROWS))))
        return found


def check_felt(session: Session) -> None:
    """Refuse presses that change nothing.

    Raises:
        CalibrationError: They change nothing beyond noise and drift.
    """
    presses = session.flat.recording.presses
    if session.changed() <= float(chi2.isf(MISFIT_LEVEL / len(presses), N_ROWS)) / N_ROWS:
        raise CalibrationError(
            f"presses change the voltages no more than noise and a drift of {DRIFT:.0%}: press harder, or leave out "
            "press_V, press_xy_mm and stamp_mm"
        )


Progress = Callable[[int, float], None]
