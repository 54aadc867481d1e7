"""Draws of devices, and of what happens to them: one seed, one device, wherever it is drawn.

::

    device      sheet, electrodes, front end, and the shape in which its reference was taken
    moment      of one deformation: uneven drift since then, and the scan that is at hand
    drift       of each sample: a common factor of all voltages
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.devices.device import Device
from eitskin_sim.devices.uncertainties import Bounds, Uncertainties
from eitskin_sim.measurement.front_end import FrontEnd
from eitskin_sim.scene.parts import Bend, Electrodes, Late, Sheet, SmoothField

Array = npt.NDArray[np.float64]

SEEDS: Final = 2**31
"""Seeds of smooth fields are below."""


@dataclass(frozen=True, slots=True)
class DrawnDevice:
    """A true device and how its reference was taken."""

    device: Device
    reference_bend: Bend
    """The sheet's shape when its reference was taken, which everybody believes to be flat."""


@dataclass(frozen=True, slots=True)
class Moment:
    """What is true of a device at one deformation, and how it is scanned there."""

    late: Late | None
    """What came to the layer since the reference was taken."""
    scan_noise_mm: float
    scan_factor: float
    """Of every length of the scan."""
    scan_amplitude: float
    """The scan shows the deformation multiplied by this."""


def draw_device(spread: Uncertainties, rng: np.random.Generator) -> DrawnDevice:
    """Return a random device."""
    sheet = Sheet(
        gauge_factor=float(rng.uniform(*spread.gauge_factor)),
        field=_field(float(rng.uniform(*spread.layer_rms)), spread, rng),
    )
    electrodes = _electrodes(spread, rng)
    along, across = rng.uniform(*spread.reference_stretch, 2)
    bend = Bend(stretch_along=1.0 + float(along), stretch_across=1.0 + float(across))
    flat = rng.random() < spread.reference_flat
    return DrawnDevice(Device(sheet, electrodes), Bend() if flat else bend)


def draw_moment(spread: Uncertainties, rng: np.random.Generator) -> Moment:
    """Return what is true of a device at a random moment after its reference was taken."""
    late = Late(
        gradient_rms=_log_uniform(spread.late_gradient_rms, rng),
        field=_field(_log_uniform(spread.late_field_rms, rng), spread, rng),
        seed=int(rng.integers(SEEDS)),
    )
    even = rng.random() < spread.late_even
    return Moment(
        late=None if even else late,
        scan_noise_mm=_log_uniform(spread.scan_noise_mm, rng),
        scan_factor=float(1.0 + spread.scan_scale * rng.standard_normal()),
        scan_amplitude=float(1.0 - rng.uniform(*spread.scan_stale)),
    )


def draw_drift(spread: Uncertainties, count: int, rng: np.random.Generator) -> Array:
    """Return (count,) common factors of samples' voltages since the reference was taken."""
    low, high = np.log(spread.drift)
    own = np.exp(rng.uniform(low, high, count))
    wild = rng.random(count) < spread.drift_wild
    found = np.where(wild, spread.drift_wild_sd, own) * rng.standard_normal(count)
    return np.exp(np.clip(found, -spread.drift_most, spread.drift_most))


def _electrodes(spread: Uncertainties, rng: np.random.Generator) -> Electrodes:
    nominal = Electrodes()
    deviation = rng.uniform(*spread.electrode_mm)
    most = spread.electrode_most_mm
    moved = np.array(nominal.arc_length_mm) + np.clip(deviation * rng.standard_normal(16), -most, most)
    each = np.exp(spread.electrode_size_each * np.clip(rng.standard_normal(16), -2.0, 2.0))
    sizes = nominal.sizes_mm() * rng.uniform(*spread.electrode_size) * each
    common, uneven = _log_uniform(spread.impedance, rng), rng.uniform(*spread.impedance_each)
    impedances = nominal.impedances_ohm_m2() * common * np.exp(uneven * rng.standard_normal(16))
    return replace(
        nominal,
        size_mm=tuple(sizes.tolist()),
        contact_impedance_ohm_m2=tuple(impedances.tolist()),
        arc_length_mm=tuple(moved.tolist()),
    )


def draw_front_end(spread: Uncertainties, rng: np.random.Generator) -> FrontEnd:
    """Return random electronics."""
    gain = 1.0 + spread.gain * rng.standard_normal(16)
    if rng.random() >= spread.front_end:
        return FrontEnd(gain=tuple(gain.tolist()))
    each = np.exp(spread.stray_each * rng.standard_normal((2, 16)))
    stray = _log_uniform(spread.leak_S, rng) * each[0] + 1j * _log_uniform(spread.stray_S, rng) * each[1]
    plus, minus, common = rng.standard_normal(3)
    sink = 1.0 + spread.sink * common + spread.sink_each * rng.standard_normal(16)
    offset = _log_uniform(spread.offset_V, rng) * rng.standard_normal((2, 16))
    return FrontEnd(
        gain=tuple(gain.tolist()),
        offset_per_drive_V=tuple(offset[0].tolist()),
        offset_per_pair_V=tuple(offset[1].tolist()),
        stray_S=tuple(stray.tolist()),
        plus_gain=float(1.0 + spread.paths * plus),
        minus_gain=float(1.0 + spread.paths * minus),
        sink_share=tuple(sink.tolist()),
        normalised=bool(rng.random() < spread.divided),
    )


def _field(rms: float, spread: Uncertainties, rng: np.random.Generator) -> SmoothField:
    return SmoothField(rms, float(rng.uniform(*spread.correlation_mm)), int(rng.integers(SEEDS)))


def _log_uniform(bounds: Bounds, rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))
