"""What a recording's moments should read for given parameters, in units of their noise, with derivatives.

A moment is the reference, or an untouched sheet that was bent and scanned. Its residual is whitened by all that is
random about it and that nobody wants to know: the noise of its frames, the scan's own noise carried through the forward
model, the uneven drift since the reference, and the model's error. Two more numbers belong to each bent moment and are
estimated with the rest: the common drift, and how unevenly the sheet is stretched where no scan shows it.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy import linalg

from eitskin_proto.sensor.table import FULL_TABLE, N_ELECTRODES, N_FULL_ROWS, TABLE
from eitskin_proto.skin.skin import Skin
from eitskin_sim.calibration.modes import SmoothModes
from eitskin_sim.calibration.parameters import OWN_LAYER, Parameters
from eitskin_sim.calibration.recording import Moment, Recording
from eitskin_sim.calibration.solved import Shape, Solved
from eitskin_sim.devices.readings import responses_of
from eitskin_sim.fem.forward import flat_metric
from eitskin_sim.measurement.front_end import FrontEnd, capacitance
from eitskin_sim.scene.parts import Electrodes
from eitskin_sim.surface.predict import fit_cloud, predict

Array = npt.NDArray[np.float64]

MODEL_ERROR: Final = 5e-4
"""Of every row, relative: the mesh's 2e-4, and what of the layer is finer than its modes."""

BENT_ERROR: Final = 0.015
"""The same of a bent moment: a scan's rows are divided evenly by arc length, and uneven stretch moves what lies between
them; drawn deformations with the true unevenness were about 0.7 % off."""

SCANS: Final = 24
"""Noisy copies of a cloud that its voltages' covariance is taken from."""

SHRUNK: Final = 0.3
"""Share of that covariance that is its diagonal: as many copies do not span all rows."""

COMMON: Final = 1e-3
"""Least standard deviation of a moment's common drift, for a skin that states none: no instrument holds less."""

FRONT_END: Final = ("gain", "offset_V", "stray_pF", "minus_gain", "sink_share")

TINY: Final = 1e-4
"""Relative step of voltages along a derivative: the front end is all but linear."""

LOCAL: Final = 2
"""Parameters of each bent moment: common drift, and uneven stretch."""


@dataclass(frozen=True, slots=True)
class Read:
    """A moment's voltages at some parameters."""

    voltages_V: Array
    """(rows,)"""
    jacobian: Array | None
    """(rows, parameters), V by each prior standard deviation."""


class Model:
    """A recording's untouched moments.

    Args:
        skin: The stated one.
        recording: What was read.
        snr_db: Of a single frame; None takes the least that the skin states.
    """

    def __init__(self, skin: Skin, recording: Recording, snr_db: float | None = None) -> None:
        doubts = skin.may_be_off
        self.skin, self.size_mm = skin, skin.outline.size_mm
        self.moments: tuple[Moment, ...] = (recording.reference, *recording.untouched)
        self.layer = SmoothModes(self.size_mm, doubts.layer_rms, doubts.layer_correlation_mm)
        self._late = SmoothModes(self.size_mm, doubts.late_rms, doubts.late_correlation_mm)
        scans = [one.cloud_mm for one in self.moments]
        self.parameters = Parameters(
            skin,
            self.layer.count,
            scanned=any(one is not None for one in scans),
            bent=len(scans) > 1 or scans[0] is not None,
            flat_unknown=scans[0] is None,
        )
        drift, uneven = doubts.drift, skin.deformations.nonuniformity
        width = drift.spread / (np.sqrt(3.0) if drift.law == "uniform" else 1.0)
        self.local_spread = np.array([max(width, COMMON), max(abs(one) for one in uneven) / np.sqrt(3.0)])
        self.level = 10.0 ** (-(min(skin.front_end.snr_db) if snr_db is None else snr_db) / 20.0)
        self._metrics: list[Any] = [flat_metric if one is None else self._scanned(one) for one in scans]
        self._scan_covariances = [
            np.zeros(0) if one.cloud_mm is None else scan_covariance(one.cloud_mm, skin, len(one.voltages_V))
            for one in self.moments
        ]
        self._whiteners: list[Array] = []
        self.soften(np.zeros(self.count), 0.0)

    @property
    def count(self) -> int:
        """How many parameters there are, with those of the moments."""
        return self.parameters.count + LOCAL * (len(self.moments) - 1)

    def local(self, moment: int) -> slice:
        """Return where a bent moment's own parameters are."""
        start = self.parameters.count + LOCAL * (moment - 1)
        return slice(start, start + LOCAL)

    def soften(self, z: Array, error: float) -> None:
        """Take every row for uncertain by a share of it beside all else, from now on; 0 for as sure as it is.

        Args:
            z: Where what the noise does is worked out.
            error: Relative.
        """
        self._whiteners = [self._whitener(z, number, error) for number in range(len(self.moments))]

    def residuals(self, z: Array) -> Array:
        """Return (all rows,) whitened: what was read less what should be."""
        return self._all(z, derivatives=False)[0]

    def linearised(self, z: Array) -> tuple[Array, Array]:
        """Return the residuals and (all rows, count) how what should be read changes, both whitened."""
        found, jacobian = self._all(z, derivatives=True)
        assert jacobian is not None
        return found, jacobian

    def _all(self, z: Array, *, derivatives: bool) -> tuple[Array, Array | None]:
        found = []
        for number, moment in enumerate(self.moments):
            read = self.read(z, number, derivatives=derivatives)
            whiten = self._whiteners[number]
            jacobian = None if read.jacobian is None else whiten @ read.jacobian
            found.append((whiten @ (moment.voltages_V - read.voltages_V), jacobian))
        residuals = np.concatenate([one for one, _ in found])
        if not derivatives:
            return residuals, None
        return residuals, np.concatenate([one for _, one in found if one is not None])

    # -- one moment ----------------------------------------------------------------------------------------------------

    def electrodes(self, z: Array) -> Electrodes:
        """Return the electrodes, their impedances for a layer of 1 S/m."""
        parameters = self.parameters
        impedance = parameters.values("contact_impedance_ohm_m2", z) * parameters.one("level", z)
        return Electrodes(
            size_mm=tuple(parameters.values("size_mm", z).tolist()),
            contact_impedance_ohm_m2=tuple(impedance.tolist()),
            arc_length_mm=tuple(parameters.values("arc_length_mm", z).tolist()),
        )

    def front_end(self, z: Array) -> FrontEnd:
        """Return the instrument."""
        values = self.parameters.values
        stray = tuple(values("stray_pF", z).tolist())
        return FrontEnd(
            gain=tuple(values("gain", z).tolist()),
            offset_per_pair_V=tuple(values("offset_V", z).tolist()),
            stray_S=capacitance(stray, self.skin.front_end.frequency_Hz),
            minus_gain=self.parameters.one("minus_gain", z),
            sink_share=self.parameters.one("sink_share", z),
            normalised=self.skin.front_end.normalised,
        )

    def shape(self, z: Array, number: int) -> Shape:
        """Return what lies about a moment's sheet beside its scan."""
        parameters, uneven = self.parameters, 0.0
        if number:
            uneven = float(self.local_spread[1] * z[self.local(number)][1])
        if self.moments[number].cloud_mm is None:
            along, across = parameters.one("length_scale", z), parameters.one("width_scale", z)
            if not number:
                stretch = parameters.values("reference_stretch", z)
                along, across = along * (1.0 + stretch[0]), across * (1.0 + stretch[1])
        else:
            along = across = 1.0 / parameters.one("scan_scale", z)
        gauge, thickness = parameters.one("gauge_factor", z), parameters.one("thickness_mm", z)
        return Shape(float(np.log(along)), float(np.log(across)), uneven, gauge, float(np.log(thickness)))

    def solved(self, z: Array, number: int) -> Solved:
        """Return a moment's sheet."""
        own = z[self.parameters.slices[OWN_LAYER]] if self.layer.count else np.zeros(0)
        return Solved(
            self.size_mm, self.electrodes(z), self._metrics[number], self.shape(z, number), self.layer.at, own
        )

    def drift(self, z: Array, number: int) -> float:
        """Return the factor of all resistances since the reference."""
        return float(np.exp(self.local_spread[0] * z[self.local(number)][0])) if number else 1.0

    def read(self, z: Array, number: int, *, derivatives: bool) -> Read:
        """Return what a moment should read.

        Raises:
            ValueError: Electrodes overlap, or the sheet folds: parameters that no sheet has.
        """
        sheet = self.solved(z, number)
        scale = self.drift(z, number) / self.parameters.one("level", z)
        instrument, table = self.front_end(z), table_of(self.moments[number])
        differences = scale * sheet.differences
        volts = instrument.read(responses_of(differences), table)
        if not derivatives:
            return Read(volts, None)
        names, rates = self._rates(z, number, sheet)
        norm = np.linalg.norm(differences)
        size = np.linalg.norm(scale * rates, axis=(1, 2)) + 1e-300
        steps = TINY * norm * rates * scale / size[:, None, None]
        moved = instrument.read(responses_of(differences + steps), table) - volts
        jacobian = np.zeros((len(volts), self.count))
        for at, change, much in zip(names, moved, size, strict=True):
            jacobian[:, at] += change * much / (TINY * norm)
        self._by_front_end(z, responses_of(differences), table, jacobian)
        return Read(volts, jacobian)

    def _rates(self, z: Array, number: int, sheet: Solved) -> tuple[list[int], Array]:
        """Return the parameters that the sheet's differences (16, 16) depend on, and their derivatives by each z."""
        parameters, slices = self.parameters, self.parameters.slices
        at: list[int] = []
        rates: list[Array] = []

        def add(name: str, rate: Array, by_value: Array) -> None:
            """Take derivatives (n, 16, 16) by values, and those of values by z."""
            if name in slices:
                at.extend(range(slices[name].start, slices[name].stop))
                rates.extend(by_value[:, None, None] * rate)

        def by_z(name: str) -> Array:
            group = parameters.groups.get(name)
            return np.zeros(1) if group is None else group.errors(z[slices[name]], np.ones(len(group.stated)))

        impedance = sheet.by_log_impedance()
        add("arc_length_mm", sheet.by_place(), by_z("arc_length_mm"))
        add("size_mm", sheet.by_size(), by_z("size_mm"))
        values = parameters.values("contact_impedance_ohm_m2", z)
        add("contact_impedance_ohm_m2", impedance, by_z("contact_impedance_ohm_m2") / values)
        level = parameters.groups["level"].spread
        add("level", (impedance.sum(axis=0) - sheet.differences)[None], np.array([level]))
        if "gauge_factor" in slices:
            add("gauge_factor", sheet.by_shape("gauge_factor")[None], by_z("gauge_factor"))
        if "thickness_mm" in slices:
            by_value = by_z("thickness_mm") / parameters.one("thickness_mm", z)
            add("thickness_mm", sheet.by_shape("log_thickness")[None], by_value)
        if self.moments[number].cloud_mm is not None:
            if "scan_scale" in slices:
                both = sheet.by_shape("log_along") + sheet.by_shape("log_across")
                add("scan_scale", -both[None], by_z("scan_scale") / parameters.one("scan_scale", z))
        elif {"length_scale", "width_scale", "reference_stretch"} & set(slices):
            both = np.stack([sheet.by_shape("log_along"), sheet.by_shape("log_across")])
            for axis, name in enumerate(("length_scale", "width_scale")):
                add(name, both[axis : axis + 1], by_z(name) / parameters.one(name, z))
            if not number:
                add("reference_stretch", both, by_z("reference_stretch") / (1.0 + self._stretch(z)))
        if self.layer.count:
            add(OWN_LAYER, sheet.by_layer(), np.ones(self.layer.count))
        if number:
            own = self.local(number)
            at += [own.start, own.start + 1]
            rates += [self.local_spread[0] * sheet.differences, self.local_spread[1] * sheet.by_shape("nonuniformity")]
        return at, np.array(rates)

    def _stretch(self, z: Array) -> Array:
        return self.parameters.values("reference_stretch", z)

    def _by_front_end(self, z: Array, responses: Array, table: npt.NDArray[np.uint8], jacobian: Array) -> None:
        step = 1e-3
        for name in FRONT_END:
            if name not in self.parameters.slices:
                continue
            own = self.parameters.slices[name]
            for at in range(own.start, own.stop):
                moved = [z.copy(), z.copy()]
                moved[0][at] -= step
                moved[1][at] += step
                low, high = (self.front_end(one).read(responses, table) for one in moved)
                jacobian[:, at] = (high - low) / (2.0 * step)

    # -- what is random ------------------------------------------------------------------------------------------------

    def _whitener(self, z: Array, number: int, error: float) -> Array:
        """Return (rows, rows) W with W C W^T = 1, C the covariance of what is random about a moment."""
        moment = self.moments[number]
        volts = moment.voltages_V
        sure = (BENT_ERROR if number else MODEL_ERROR) ** 2 + error**2
        covariance = np.diag(noise_V(self.skin, volts, self.level, moment.frames) ** 2 + sure * volts**2)
        if moment.cloud_mm is not None:
            covariance += self._scan_covariances[number] * np.outer(volts, volts)
        if number and self._late.count:
            sheet = self.solved(z, number)
            rates = sheet.by_layer(self._late.at(sheet.mesh.centres_mm)) / self.parameters.one("level", z)
            base, table = sheet.differences / self.parameters.one("level", z), table_of(moment)
            instrument = self.front_end(z)
            step = 0.01
            moved = instrument.read(responses_of(base + step * rates), table)
            late = (moved - instrument.read(responses_of(base), table)) / step
            covariance += late.T @ late
        return np.asarray(linalg.solve_triangular(np.linalg.cholesky(covariance), np.eye(len(volts)), lower=True))

    def _scanned(self, cloud: Array) -> Any:
        return fit_cloud(cloud, self.skin.grid).metric


def noise_V(skin: Skin, volts: Array, level: float, frames: int) -> Array:
    """Return (rows,) standard deviations of what noise does to the mean of some frames."""
    size = np.sqrt(np.mean(volts**2)) * np.ones(len(volts)) if skin.front_end.noise == "N3" else np.abs(volts)
    return np.asarray(level * size / np.sqrt(frames))


def scan_covariance(cloud_mm: Array, skin: Skin, rows: int) -> Array:
    """Return (rows, rows) the covariance of relative voltages that the scan's noise gives."""
    low, high = skin.may_be_off.scan_noise_mm
    noise_mm = np.sqrt((low * low + low * high + high * high) / 3.0)
    rng = np.random.default_rng(0)
    still = predict(cloud_mm, skin)
    noisy = [predict(cloud_mm + noise_mm * rng.standard_normal(cloud_mm.shape), skin) for _ in range(SCANS)]
    apart = np.array(noisy) / still - 1.0
    found = (apart - apart.mean(axis=0)).T @ (apart - apart.mean(axis=0)) / (SCANS - 1)
    found = (1.0 - SHRUNK) * found + SHRUNK * np.diag(np.diag(found))
    if rows == len(found):
        return np.asarray(found)
    where = np.zeros((N_ELECTRODES, N_ELECTRODES), dtype=np.intp)
    where[TABLE[:, 0], TABLE[:, 1]] = where[TABLE[:, 1], TABLE[:, 0]] = np.arange(len(TABLE))
    row = where[FULL_TABLE[:, 0], FULL_TABLE[:, 1]]
    return np.asarray(found[np.ix_(row, row)])


def table_of(moment: Moment) -> npt.NDArray[np.uint8]:
    """Return (rows, 2) drives and measures of a moment's rows."""
    return FULL_TABLE if len(moment.voltages_V) == N_FULL_ROWS else TABLE
