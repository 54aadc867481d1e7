"""One true device, drawn: its scenes, its reference, and the scans that its robot takes.

The same draws serve every size of a deviation: an electrode that deviates by z standard deviations deviates by z times
1 mm, or 2 mm. Solvers do not see the deviations: they know the nominal sheet of the skin's description.
"""

from dataclasses import dataclass, replace

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.evaluation.mismatch import Mismatch
from eitskin_sim.measurement.front_end import FrontEnd, capacitance
from eitskin_sim.scene.family import scaled
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import Bend, Electrodes, LaterChanges, Scene, Sheet, SmoothField, Touch
from eitskin_sim.scene.shapes import Disc, Ellipse, Polygon, Rect, Shape
from eitskin_sim.surface.measured_cloud import measured_cloud

MAX_OFFSET_SD = 2.5
"""Largest deviation of an electrode in standard deviations: it stays on its side of the border."""

DRAW_SEED = 31_007
"""Devices have seeds of their own, apart from those of any data set."""


@dataclass(frozen=True, slots=True, eq=False)
class Device:
    """A true device."""

    mismatch: Mismatch
    sheet: Sheet
    electrodes: Electrodes
    front_end: FrontEnd
    skin: Skin = PAPER
    """What it was meant to be."""

    @property
    def longer(self) -> float:
        """Its length over the nominal one."""
        return self.sheet.size_mm[0] / self.skin.outline.size_mm[0]

    def scene(self, nominal: Scene, *, as_it_is: bool) -> Scene:
        """Return the true scene of a nominal one.

        Args:
            nominal: Bend and touches, in the nominal sheet's coordinates.
            as_it_is: Leave the touches their own contrast and border.
        """
        off = self.mismatch
        touches = tuple(_touch(one, None if as_it_is else off, self.longer) for one in nominal.touches)
        bend = replace(nominal.bend, nonuniformity=nominal.bend.nonuniformity + off.unseen_stretch)
        return replace(nominal, sheet=self.sheet, electrodes=self.electrodes, bend=bend, touches=touches)

    def reference(self) -> Scene:
        """Return the true scene when the one reference was taken."""
        bend = Bend(stretch_along=1.0 + self.mismatch.reference_stretch)
        return replace(Scene(self.sheet, self.electrodes).reference(), bend=bend)

    def cloud(self, bend: Bend, rng: np.random.Generator) -> Array | None:
        """Return the (3, rows, columns) mm scan of a nominal bend; None where there is none."""
        off = self.mismatch
        if not off.scan:
            return None
        shown = bend if not off.scan_stale_deg else scaled(bend, 1.0 - off.scan_stale_deg / 180.0)
        shown = replace(shown, stretch_along=shown.stretch_along * self.longer)
        return off.scan_scale * measured_cloud(shown, rng, off.scan_noise_mm, self.skin).astype(np.float64)


def draw_device(mismatch: Mismatch, seed: int, number: int, skin: Skin = PAPER) -> Device:
    """Return one device of a mismatch.

    Args:
        mismatch: How large deviations are.
        seed: Names the sequence of devices.
        number: Which of them.
        skin: What it was meant to be.

    Raises:
        SceneError: The skin is no rectangle, or a length of the mismatch is none of such a sheet.
    """
    mismatch.require(skin)
    rng = np.random.default_rng([DRAW_SEED, seed, number])
    places = np.clip(rng.standard_normal(N_ELECTRODES), -MAX_OFFSET_SD, MAX_OFFSET_SD)
    contacts = rng.standard_normal(N_ELECTRODES)
    field_seed, late_seed = (int(one) for one in rng.integers(2**31, size=2))
    gains, offsets, strays = rng.standard_normal((3, N_ELECTRODES))
    off, sheet, nominal = mismatch, nominal_sheet(skin), nominal_electrodes(skin)
    size_mm = (_or(off.length_mm, sheet.size_mm[0]), sheet.size_mm[1])
    arc = _along(np.array(nominal.arc_length_mm), sheet.size_mm, size_mm[0]) + off.electrodes_mm * places
    impedance = nominal.impedances_ohm_m2() * off.impedance_factor * np.exp(off.impedance_spread * contacts)
    drifts = off.drift_percent or off.gradient_rms
    late = LaterChanges(1.0 + off.drift_percent / 100.0, off.gradient_rms, None, late_seed) if drifts else None
    return Device(
        mismatch=mismatch,
        sheet=replace(
            sheet,
            size_mm=size_mm,
            thickness_mm=_or(off.thickness_mm, sheet.thickness_mm),
            gauge_factor=_or(off.gauge_factor, sheet.gauge_factor),
            field=SmoothField(off.field_rms, off.field_mm, field_seed) if off.field_rms else None,
            late=late,
        ),
        electrodes=replace(
            nominal,
            size_mm=nominal.size_mm if off.electrode_size_mm is None else off.electrode_size_mm,
            contact_impedance_ohm_m2=tuple(impedance.tolist()),
            arc_length_mm=tuple(arc.tolist()),
        ),
        front_end=_front_end(off, gains, offsets, strays, skin),
        skin=skin,
    )


def _or(stated: float | None, nominal: float) -> float:
    return nominal if stated is None else stated


def _front_end(off: Mismatch, gains: Array, offsets: Array, strays: Array, skin: Skin) -> FrontEnd:
    """Return electronics of directions (16,) each; an ideal one where none is off."""
    stray_pF = off.stray_pF * np.exp(off.stray_spread * strays)
    offset_V = off.offset_V / float(skin.layer.conductivity_S_per_m.nominal(1)[0])  # of a layer of 1 S/m
    return FrontEnd(
        gain=tuple((1.0 + off.gain_percent / 100.0 * gains).tolist()) if off.gain_percent else 1.0,
        offset_per_pair_V=tuple((offset_V * offsets).tolist()) if off.offset_V else 0.0,
        stray_S=capacitance(tuple(stray_pF.tolist()), skin.front_end.frequency_Hz) if off.stray_pF else 0.0,
        minus_gain=1.0 - off.minus_percent / 100.0,
        sink_share=1.0 - off.sink_percent / 100.0,
    )


def _along(arc_mm: Array, size_mm: tuple[float, float], length_mm: float) -> Array:
    """Return places on the border of a sheet of another length: those along it move with it."""
    (nominal, width), more = size_mm, length_mm - size_mm[0]
    low, high = np.clip(arc_mm / nominal, 0.0, 1.0), np.clip((arc_mm - nominal - width) / nominal, 0.0, 1.0)
    return np.asarray(arc_mm + more * (low + high))


def _touch(touch: Touch, off: Mismatch | None, stretch: float) -> Touch:
    moved = touch if stretch == 1.0 else replace(touch, shapes=tuple(_stretched(one, stretch) for one in touch.shapes))
    if off is None or (off.contrast is None and not off.alters_touches):
        return moved
    return replace(
        moved,
        contrast=touch.contrast if off.contrast is None else off.contrast,
        border_mm=off.border_mm or touch.border_mm,
        dent_mm=off.dent_mm or touch.dent_mm,
    )


def _stretched(shape: Shape, stretch: float) -> Shape:
    match shape:
        case Rect(x0, y0, x1, y1):
            return Rect(x0 * stretch, y0, x1 * stretch, y1)
        case Disc(x, y, radius):
            return Disc(x * stretch, y, radius)
        case Ellipse():
            return replace(shape, x_mm=shape.x_mm * stretch)
        case Polygon(corners):
            return Polygon(tuple((x * stretch, y) for x, y in corners))
