"""The voltages of a sheet for given parameters, with derivatives: untouched, flat or scanned, or pressed.

The residual of the untouched reference is whitened by the noise of its frames and the model's error. Later moments are
compared with it in :mod:`eitskin_sim.calibration.session`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import FULL_TABLE, N_FULL_ROWS, N_ROWS, TABLE
from eitskin_proto.skin.skin import Skin
from eitskin_proto.wire.scan_rows import TABLE_ROW_OF_FULL
from eitskin_sim.arrays import Array
from eitskin_sim.calibration.modes import SmoothModes
from eitskin_sim.calibration.parameters import (
    COMMON_OFFSET,
    COMMON_OFFSET_SPREAD,
    LAYER_MODES,
    ParameterGroup,
    Parameters,
    check_contacts,
)
from eitskin_sim.calibration.recording import Recording, noise_V, of_table
from eitskin_sim.calibration.solved import Metric, Shape, Solved
from eitskin_sim.calibration.unseen import UNSEEN, unseen_of
from eitskin_sim.devices.readings import responses_of
from eitskin_sim.fem.forward import flat_metric
from eitskin_sim.measurement.front_end import FrontEnd, capacitance
from eitskin_sim.scene.parts import Electrodes, Touch

MODEL_ERROR: Final = 5e-4
"""Of every row, relative: the mesh's 2e-4, and what of the layer is finer than its modes."""

GAUGE: Final = "gauge_factor"

FRONT_END: Final = ("gain", "offset_V", COMMON_OFFSET, "stray_pF", "minus_gain", "sink_share")

TOUCH_STEP: Final = 1e-2
"""Half the distance of compared touches, in prior standard deviations."""

DERIVATIVE_STEP: Final = 1e-4
"""Relative step of voltages along a derivative: the front end is all but linear."""


@dataclass(frozen=True, slots=True)
class ModelVoltages:
    """The voltages at some parameters."""

    voltages_V: Array
    """(rows,)"""
    jacobian: Array | None
    """(rows, parameters), V by each prior standard deviation."""


@dataclass(frozen=True, slots=True)
class SheetState:
    """The sheet's shape and press; by default those of the reference."""

    scanned: Metric | None = None
    """The scanned shape; None is flat."""
    touches: Callable[[Array], tuple[Touch, ...]] = field(default=lambda _: ())
    """z (count,) -> the touches."""
    touched_by: Sequence[int] = ()
    """Parameters that touches depend on."""
    at_reference: bool = True
    """Whether it has the shape of the reference."""


class Model:
    """A recording's reference.

    Args:
        skin: The stated one.
        recording: The recording.
        snr_db: Of a single frame; None takes the least that the skin states.
        more: Additional groups of parameters.

    Raises:
        ValueError: The skin's contacts are no patches.
    """

    def __init__(
        self, skin: Skin, recording: Recording, snr_db: float | None = None, more: Sequence[ParameterGroup] = ()
    ) -> None:
        doubts = skin.may_be_off
        check_contacts(skin)
        self.skin, self.size_mm = skin, skin.outline.size_mm
        self.recording, self.snr_db = recording, snr_db
        self.layer = SmoothModes(self.size_mm, doubts.layer_rms, doubts.layer_correlation_mm)
        self.unseen = None if recording.cloud_mm is None else unseen_of(skin, recording.cloud_mm)
        """Of a reference with its scan."""
        self.base = SheetState(None if self.unseen is None else self.unseen.metric)
        """How the sheet lay when the reference was taken."""
        own = [] if self.unseen is None else [self.unseen.group]
        if offset := recording.offset_V:
            spread = COMMON_OFFSET_SPREAD * abs(offset)
            own.append(ParameterGroup(COMMON_OFFSET, "V", np.array([offset]), spread))
        self.parameters = Parameters(skin, self.layer.count, [*own, *more])
        self.level = 10.0 ** (-(min(skin.front_end.snr_db) if snr_db is None else snr_db) / 20.0)
        self._whitener = self._whitening(0.0)
        self._unseen_by_gauge = np.zeros(N_ROWS)
        if self.unseen is not None:
            self._unseen_by_gauge = self.unseen.steeper * self.slope(replace(self.base, at_reference=False))

    @property
    def count(self) -> int:
        """How many parameters there are."""
        return self.parameters.count

    def inside(self, z: Array) -> Array:
        """Return the nearest (count,) parameters that a sheet can have."""
        return self.parameters.inside(z)

    def soften(self, z: Array, error: float) -> None:
        """Take every row for uncertain by a share of it beside all else, from now on; 0 for as sure as it is.

        Args:
            z: Where the search is.
            error: Relative.
        """
        self._whitener = self._whitening(error)

    def residuals(self, z: Array) -> Array:
        """Return (rows,) whitened residuals."""
        return self.whitened(self.read(z, derivatives=False).voltages_V)

    def linearised(self, z: Array) -> tuple[Array, Array]:
        """Return the residuals and (rows, count) how what should be read changes, both whitened."""
        return self.whitened_with(self.read(z, derivatives=True))

    def whitened(self, should_V: Array) -> Array:
        """Return (rows,) what was read less what should be, over its noise."""
        return np.asarray(self._whitener * (self.recording.reference_V - should_V))

    def whitened_with(self, should: ModelVoltages) -> tuple[Array, Array]:
        """Return the same, and (rows, count) the derivatives of what should be read."""
        assert should.jacobian is not None
        return self.whitened(should.voltages_V), self._whitener[:, None] * should.jacobian

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
            offset_per_pair_V=tuple((values("offset_V", z) + self.parameters.one(COMMON_OFFSET, z)).tolist()),
            stray_S=capacitance(stray, self.skin.front_end.frequency_Hz),
            minus_gain=self.parameters.one("minus_gain", z),
            sink_share=self.parameters.one("sink_share", z),
            normalised=self.skin.front_end.normalised,
        )

    def shape(self, z: Array, lying: SheetState) -> Shape:
        """Return the change of the metric; a scan shows the true lengths."""
        parameters = self.parameters
        gauge, thickness = parameters.one(GAUGE, z), parameters.one("thickness_mm", z)
        if lying.scanned is not None:
            return Shape(gauge_factor=gauge, log_thickness=float(np.log(thickness)))
        stretch = 1.0 + parameters.values("reference_stretch", z)
        along, across = parameters.one("length_scale", z) * stretch[0], parameters.one("width_scale", z) * stretch[1]
        return Shape(float(np.log(along)), float(np.log(across)), 0.0, gauge, float(np.log(thickness)))

    def solved(self, z: Array, lying: SheetState | None = None) -> Solved:
        """Return the sheet; as it lay when the reference was taken where nothing else is said."""
        lying = self.base if lying is None else lying
        own = z[self.parameters.slices[LAYER_MODES]] if self.layer.count else np.zeros(0)
        metric, shape = lying.scanned or flat_metric, self.shape(z, lying)
        return Solved(self.size_mm, self.electrodes(z), metric, shape, self.layer.at, own, lying.touches(z))

    def read(self, z: Array, lying: SheetState | None = None, *, derivatives: bool) -> ModelVoltages:
        """Return the expected voltages; by default for the shape of the reference.

        Raises:
            ValueError: Electrodes overlap, or the sheet folds: parameters that no sheet has.
        """
        lying = self.base if lying is None else lying
        sheet = self.solved(z, lying)
        scale = 1.0 / self.parameters.one("level", z)
        instrument, table = self.front_end(z), self.table
        differences = scale * sheet.differences
        volts = instrument.read(responses_of(differences), table)
        factor = np.exp(self.unseen_log(z)) if lying.at_reference else np.ones(len(volts))
        if not derivatives:
            return ModelVoltages(factor * volts, None)
        names, rates = self._rates(z, sheet, lying)
        norm = np.linalg.norm(differences)
        size = np.linalg.norm(scale * rates, axis=(1, 2)) + 1e-300
        steps = DERIVATIVE_STEP * norm * rates * scale / size[:, None, None]
        moved = instrument.read(responses_of(differences + steps), table) - volts
        jacobian = np.zeros((len(volts), self.count))
        for at, change, much in zip(names, moved, size, strict=True):
            jacobian[:, at] += change * much / (DERIVATIVE_STEP * norm)
        self._by_front_end(z, responses_of(differences), table, jacobian)
        jacobian *= factor[:, None]
        if self.unseen is not None and lying.at_reference:
            rows, slices = self._table_row, self.parameters.slices
            jacobian[:, slices[UNSEEN]] += (factor * volts)[:, None] * self.unseen.root[rows]
            if GAUGE in slices:
                by_z = self.parameters.groups[GAUGE].spread * self._unseen_by_gauge
                jacobian[:, slices[GAUGE]] += (factor * volts * by_z[rows])[:, None]
        return ModelVoltages(factor * volts, jacobian)

    def unseen_log(self, z: Array) -> Array:
        """Return (rows,) logarithms of what the reference is off by, of what its scan does not show; 0 of a flat one.

        Args:
            z: (count,)
        """
        if self.unseen is None:
            return np.zeros(len(self.table))
        own = self.unseen.root @ z[self.parameters.slices[UNSEEN]]
        found = self.unseen.mean + own + self.parameters.one(GAUGE, z) * self._unseen_by_gauge
        return np.asarray(found[self._table_row])

    def slope(self, lying: SheetState) -> Array:
        """Return (104,) how the logarithms of a sheet's voltages follow the gauge factor, as it is stated.

        Args:
            lying: As something scanned.
        """
        if GAUGE not in self.parameters.slices:
            return np.zeros(N_ROWS)
        read = self.read(np.zeros(self.count), lying, derivatives=True)
        assert read.jacobian is not None
        by_z = read.jacobian[:, self.parameters.slices[GAUGE]][:, 0] / read.voltages_V
        return np.asarray(of_table(by_z) / self.parameters.groups[GAUGE].spread)

    def _rates(self, z: Array, sheet: Solved, lying: SheetState) -> tuple[list[int], Array]:
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
        if "thickness_mm" in slices:
            by_value = by_z("thickness_mm") / parameters.one("thickness_mm", z)
            add("thickness_mm", sheet.by_shape("log_thickness")[None], by_value)
        if GAUGE in slices:
            add(GAUGE, sheet.by_shape(GAUGE)[None], by_z(GAUGE))
        if lying.scanned is None and {"length_scale", "width_scale", "reference_stretch"} & set(slices):
            both = np.stack([sheet.by_shape("log_along"), sheet.by_shape("log_across")])
            for axis, name in enumerate(("length_scale", "width_scale")):
                add(name, both[axis : axis + 1], by_z(name) / parameters.one(name, z))
            stretch = parameters.values("reference_stretch", z)
            add("reference_stretch", both, by_z("reference_stretch") / (1.0 + stretch))
        if self.layer.count:
            add(LAYER_MODES, sheet.by_layer(), np.ones(self.layer.count))
        for one in lying.touched_by:
            step = TOUCH_STEP * np.eye(self.count)[one]
            at.append(one)
            rates.append(sheet.by_touches(lying.touches(z - step), lying.touches(z + step)) / (2.0 * TOUCH_STEP))
        return at, np.array(rates)

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

    def _whitening(self, error: float) -> Array:
        """Return (rows,) one over the standard deviations of what is random."""
        volts = self.recording.reference_V
        noise = noise_V(self.skin, volts, self.level, self.recording.frames)
        return np.asarray(1.0 / np.sqrt(noise**2 + (MODEL_ERROR**2 + error**2) * volts**2))

    @property
    def table(self) -> npt.NDArray[np.uint8]:
        """(rows, 2) drives and measures of the rows."""
        return FULL_TABLE if len(self.recording.reference_V) == N_FULL_ROWS else TABLE

    @property
    def _table_row(self) -> npt.NDArray[np.intp]:
        """(rows,) which of the 104 each row is, or is the reciprocal of."""
        return TABLE_ROW_OF_FULL if len(self.recording.reference_V) == N_FULL_ROWS else np.arange(N_ROWS)
