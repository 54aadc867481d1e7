"""Draws of true devices from a skin's description: one seed, one device, wherever it is drawn.

::

    device      sheet, electrodes, front end; its true size, and the stretch at which its reference was taken
    moment      of one deformation: the uneven drift since then, and the scan that is at hand
    drift       of each sample: a common factor of all resistances

Drift is a random walk that starts when the reference is taken. A sample comes at a time that is log-uniform, from
``EARLIEST_SAMPLE`` of a session to its end, and the walk reaches the skin's spread at the end: with one of 3 %, half of
the samples are off by less than 0.5 % and a tenth by more than 2.3 %. A few have a reference of long ago: one in a
hundred is off by 12 % or more. The uneven part walks likewise, as a smooth field and a tilt.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.parts import Range
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.devices.device import Device, ideal
from eitskin_sim.measurement.front_end import FrontEnd, capacitance
from eitskin_sim.scene.parts import Bend, Electrodes, LaterChanges, Sheet, SmoothField

SEEDS: Final = 2**31
"""Seeds of smooth fields are below."""

EARLIEST_SAMPLE: Final = 1.0 / 300.0
"""The earliest sample, as a share of a session of 300 presses."""

OLD_REFERENCE_SHARE: Final = 0.03
"""Share of samples whose reference is of another day."""

OLD_REFERENCE_DRIFT_FACTOR: Final = 4.0
"""Their drift in multiples of a session's at its end."""

MAX_DRIFT: Final = 0.3
"""No sample's logarithm of the common factor is further from 0."""

MAX_ELECTRODE_OFFSET_MM: Final = 2.0
"""No electrode is further from its stated place: it would be seen."""

OFFSETS_V: Final = (0.1, 60.0)
"""Offset of all rows, for 1 A and 1 S/m, of devices that are read with one; a sheet was measured with 42 V."""

MIN_ELECTRODE_SIZE_RATIO: Final = 0.5
"""No electrode is smaller than this share of its stated size, nor larger than its inverse."""


@dataclass(frozen=True, slots=True)
class DrawnDevice:
    """A true device, its true size, and how its reference was taken."""

    device: Device
    scale: tuple[float, float]
    """True length along x, and width along y, over the stated ones."""
    reference_stretch: tuple[float, float]
    """Factors of them when the reference was taken, which everybody believes to be flat."""

    @property
    def reference_bend(self) -> Bend:
        """The sheet's shape when its reference was taken, from the stated size."""
        return self.bent(Bend(stretch_along=self.reference_stretch[0], stretch_across=self.reference_stretch[1]))

    def bent(self, bend: Bend) -> Bend:
        """Return a bend of the stated sheet as a bend of the true one, which is a little longer or wider."""
        along, across = self.scale
        return replace(bend, stretch_along=bend.stretch_along * along, stretch_across=bend.stretch_across * across)


@dataclass(frozen=True, slots=True)
class Moment:
    """The state of a device at one deformation, and the scan there."""

    late: LaterChanges
    """The change of the layer since the reference."""
    scan_noise_mm: float
    scan_factor: float
    """Of every length of the scan."""
    scan_amplitude: float
    """The scan shows the deformation multiplied by this."""


def draw_device(skin: Skin, rng: np.random.Generator, *, offset: bool = False) -> DrawnDevice:
    """Return a random device of a skin; see :func:`draw_front_end` for its offset.

    Raises:
        ValueError: The skin is no rectangle.
    """
    check_outline(skin)
    doubts, layer = skin.may_be_off, skin.layer
    sheet = Sheet(
        size_mm=skin.outline.size_mm,
        thickness_mm=max(_one(layer.thickness_mm, rng), 0.1),
        gauge_factor=_one(layer.gauge_factor, rng),
        field=_field(float(rng.uniform(*doubts.layer_rms)), doubts.layer_correlation_mm, rng),
    )
    scale = _one(layer.length_scale, rng), _one(layer.width_scale, rng)
    stretch = 1.0 + doubts.reference_stretch.draw(rng, 2)
    device = Device(sheet, _electrodes(skin, rng), draw_front_end(skin, rng, offset=offset))
    return DrawnDevice(device, scale, (float(stretch[0]), float(stretch[1])))


def check_outline(skin: Skin) -> None:
    """Raise ValueError if devices of a skin cannot be computed on the generators' meshes: it is no rectangle."""
    ideal(skin)


def draw_front_end(skin: Skin, rng: np.random.Generator, *, offset: bool = False) -> FrontEnd:
    """Return random electronics of a skin.

    Args:
        skin: The skin.
        rng: Source of the draws; without an offset they are the same as before there were offsets.
        offset: Whether all rows have an offset of ``OFFSETS_V`` in common, of the readings' own sign.
    """
    own = skin.front_end
    sigma = float(skin.layer.conductivity_S_per_m.nominal(1)[0])  # the layer is scaled to 1 S/m, and so are these
    stray = np.maximum(own.stray_pF.draw(rng, N_ELECTRODES), 0.0) / sigma
    found = FrontEnd(
        gain=tuple(own.gain.draw(rng, N_ELECTRODES).tolist()),
        offset_per_pair_V=tuple((sigma * own.offset_V.draw(rng, N_ELECTRODES)).tolist()),
        stray_S=capacitance(tuple(stray.tolist()), own.frequency_Hz),
        minus_gain=_one(own.minus_gain, rng),
        sink_share=_one(own.sink_share, rng),
        normalised=own.normalised,
    )
    if not offset:
        return found
    common = -_log_uniform(OFFSETS_V, rng)
    return replace(found, offset_per_pair_V=tuple((np.array(found.offset_per_pair_V) + common).tolist()))


def draw_moment(skin: Skin, rng: np.random.Generator) -> Moment:
    """Return the state of a device at a random moment after its reference."""
    doubts = skin.may_be_off
    rms = float(rng.uniform(*doubts.late_rms) * _walked(1, rng)[0])
    turn = float(rng.uniform(0.0, np.pi / 2))
    late = LaterChanges(
        gradient_rms=rms * float(np.sin(turn)),
        field=_field(rms * float(np.cos(turn)), doubts.late_correlation_mm, rng),
        seed=int(rng.integers(SEEDS)),
    )
    stale = float(rng.uniform(*doubts.scan_stale) * rng.choice((-1.0, 1.0)))
    return Moment(
        late=late,
        scan_noise_mm=_log_uniform(doubts.scan_noise_mm, rng),
        scan_factor=_one(doubts.scan_scale, rng),
        scan_amplitude=1.0 - stale,
    )


def draw_drift(skin: Skin, count: int, rng: np.random.Generator) -> Array:
    """Return (count,) common factors of samples' resistances since the reference was taken."""
    whole, walked = skin.may_be_off.drift.draw(rng, count), _walked(count, rng)
    old = rng.random(count) < OLD_REFERENCE_SHARE
    return np.asarray(np.exp(np.clip(np.where(old, OLD_REFERENCE_DRIFT_FACTOR, walked) * whole, -MAX_DRIFT, MAX_DRIFT)))


def _walked(count: int, rng: np.random.Generator) -> Array:
    """Return (count,) how far random walks have come, as shares of a session's."""
    return np.sqrt(np.exp(rng.uniform(np.log(EARLIEST_SAMPLE), 0.0, count)))


def _electrodes(skin: Skin, rng: np.random.Generator) -> Electrodes:
    ring, count = skin.electrodes, N_ELECTRODES
    stated, sizes = ring.arc_length_mm.nominal(count), ring.size_mm.nominal(count)
    moved = np.clip(
        ring.arc_length_mm.draw(rng, count), stated - MAX_ELECTRODE_OFFSET_MM, stated + MAX_ELECTRODE_OFFSET_MM
    )
    if ring.contact == "edge":  # which may lie in a corner, on either side of where arc lengths begin
        moved %= skin.outline.perimeter_mm
    own = np.clip(ring.size_mm.draw(rng, count), MIN_ELECTRODE_SIZE_RATIO * sizes, sizes / MIN_ELECTRODE_SIZE_RATIO)
    impedance = np.maximum(ring.contact_impedance_ohm_m2.draw(rng, count), 1e-9)
    impedance = impedance * float(skin.layer.conductivity_S_per_m.nominal(1)[0])  # the layer is scaled to 1 S/m
    return Electrodes(
        contact=ring.contact,
        size_mm=tuple(own.tolist()),
        contact_impedance_ohm_m2=tuple(impedance.tolist()),
        arc_length_mm=tuple(moved.tolist()),
    )


def _field(rms: float, correlation_mm: Range, rng: np.random.Generator) -> SmoothField:
    return SmoothField(rms, float(rng.uniform(*correlation_mm)), int(rng.integers(SEEDS)))


def _one(quantity: Quantity, rng: np.random.Generator) -> float:
    return float(quantity.draw(rng, 1)[0])


def _log_uniform(bounds: Range, rng: np.random.Generator) -> float:
    if bounds[0] <= 0.0:
        return float(rng.uniform(*bounds))
    return float(np.exp(rng.uniform(*np.log(bounds))))
