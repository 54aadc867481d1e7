"""The parts of a skin's description: its construction, the uncertainty of that, and its use.

Lengths are mm on the flat sheet, angles degrees. A :class:`Quantity` carries its own uncertainty. Names are the keys of
``skin.toml``; a field's bounds are in its metadata, for :mod:`eitskin_proto.skin.toml` to check.
"""

# ruff: noqa: RUF009 -- the values that _of and _known give are frozen

import math
from dataclasses import dataclass, field
from typing import Any, Literal

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.touch_kind import TouchKind

Range = tuple[float, float]
"""From, to."""


def _of(default: Any, low: float, high: float, *, each: str = "", sizes: bool = False) -> Any:
    """Return a field with a default and bounds.

    Args:
        default: Its value in the paper's skin.
        low: Least number.
        high: Largest number.
        each: What a list has a number for, as "an electrode"; empty where one number is for all.
        sizes: Whether two numbers are sizes along two axes, not a range.
    """
    return field(default=default, metadata={"low": low, "high": high, "each": each, "sizes": sizes})


def _known(value: float, low: float, high: float, *, each: str = "") -> Any:
    return _of(Quantity(value), low, high, each=each)


@dataclass(frozen=True, slots=True)
class Outline:
    """The conductive sheet's border: a rectangle, or a disc in the square about it."""

    kind: Literal["rectangle", "disc"] = "rectangle"
    size_mm: tuple[float, float] = _of((150.0, 100.0), 50.0, 400.0, sizes=True)
    """Length along x and width along y; a disc's are alike, its diameter."""

    @property
    def perimeter_mm(self) -> float:
        """Length of the border."""
        length, width = self.size_mm
        return math.pi * length if self.kind == "disc" else 2.0 * (length + width)


@dataclass(frozen=True, slots=True)
class Layer:
    """The conductive layer before it is bent (paper sections III and V.A)."""

    thickness_mm: Quantity = _known(2.0, 0.05, 20.0)
    conductivity_S_per_m: Quantity = _known(1.0, 1e-4, 1e4)
    gauge_factor: Quantity = _known(0.0, -5.0, 5.0)
    """k: conductivity goes with (local stretch of area)^-k."""
    length_scale: Quantity = _known(1.0, 0.9, 1.1)
    """True length along x over the stated one."""
    width_scale: Quantity = _known(1.0, 0.9, 1.1)
    """True width along y over the stated one."""


@dataclass(frozen=True, slots=True)
class Ring:
    """The sixteen electrodes on the border, counter-clockwise."""

    contact: Literal["patch", "edge"] = "patch"
    arc_length_mm: Quantity = _of(
        Quantity(tuple(12.5 + 31.25 * k for k in range(N_ELECTRODES))), 0.0, 2e3, each="an electrode"
    )
    """Centres by arc length from the corner (0, 0); a disc's from its rightmost point."""
    size_mm: Quantity = _known(4.0, 0.5, 50.0, each="an electrode")
    contact_impedance_ohm_m2: Quantity = _known(1e-4, 1e-9, 1.0, each="an electrode")


@dataclass(frozen=True, slots=True)
class Instrument:
    """The front end: its deviations from an ideal current source and an ideal voltmeter."""

    gain: Quantity = _known(1.0, 0.1, 10.0, each="a measured pair")
    """Of each measured pair."""
    offset_V: Quantity = _known(0.0, -200.0, 200.0, each="a measured pair")
    """Offset of each measured pair, for 1 A: at 1 mA a thousand times the real one."""
    stray_pF: Quantity = _known(0.0, 0.0, 1e5, each="an electrode")
    """Capacitance from each terminal to ground."""
    frequency_Hz: float = _of(20000.0, 1.0, 1e7)
    """Of the drive current: what stray capacitance is worth."""
    minus_gain: Quantity = _known(1.0, 0.5, 2.0)
    """Gain of the path of V- over that of V+."""
    sink_share: Quantity = _known(1.0, 0.5, 1.5)
    """Current by which the sink exceeds the source; the difference returns through ground."""
    normalised: bool = False
    """Whether readings are divided by the measured current."""
    noise: Literal["N1", "N2", "N3"] = "N2"
    snr_db: Range = _of((50.0, 50.0), 10.0, 120.0)


@dataclass(frozen=True, slots=True)
class Map:
    """Where results are drawn."""

    shape: tuple[int, int] = _of((30, 45), 6, 120, sizes=True)
    """Rows and columns of pixels."""
    units: tuple[int, int] = _of((9, 14), 2, 40, sizes=True)
    """Rows and columns of the units of hard touches."""


@dataclass(frozen=True, slots=True)
class Deformations:
    """Ranges of what bends the sheet; see :class:`eitskin_sim.scene.parts.Bend`."""

    angle_deg: Range = _of((0.0, 180.0), -360.0, 360.0)
    axis_deg: Range = _of((-90.0, 90.0), -180.0, 180.0)
    skew: Range = _of((-0.8, 0.8), -2.0, 2.0)
    twist_deg: Range = _of((-40.0, 40.0), -180.0, 180.0)
    stretch_along: Range = _of((0.96, 1.22), 0.5, 2.0)
    stretch_across: Range = _of((0.92, 1.12), 0.5, 2.0)
    nonuniformity: Range = _of((-0.15, 0.15), -0.5, 0.5)


@dataclass(frozen=True, slots=True)
class Touches:
    """The touches of this skin, and the direction in which they change conductance."""

    kind: TouchKind = "raise"
    """``lower`` where touches lower conductance, as a press on a hydrogel does; ``raise`` as the paper's do; both."""
    lowering_contrast: Range = _of((0.2, 0.85), 0.01, 0.99)
    """Conductivity inside over the sheet's, of touches that lower it."""
    raising_contrast: Range = _of((20.0, 200.0), 1.01, 1000.0)
    size_mm: Range = _of((5.0, 25.0), 1.0, 100.0)
    border_mm: Range = _of((0.0, 0.0), 0.0, 20.0)

    @property
    def lower(self) -> bool:
        """Whether there are touches that lower conductance."""
        return self.kind != "raise"

    @property
    def higher(self) -> bool:
        """Whether there are touches that raise conductance."""
        return self.kind != "lower"


@dataclass(frozen=True, slots=True)
class Doubts:
    """Deviations without a stated value; zero is none."""

    layer_rms: Range = _of((0.0, 0.0), 0.0, 0.5)
    """Unevenness of the layer when the reference is taken: standard deviation of log conductivity."""
    layer_correlation_mm: Range = _of((40.0, 40.0), 5.0, 400.0)
    drift: Quantity = _known(0.0, -0.5, 0.5)
    """Logarithm of the common factor since the reference."""
    late_rms: Range = _of((0.0, 0.0), 0.0, 0.3)
    """Unevenness that came after the reference: standard deviation of log conductivity."""
    late_correlation_mm: Range = _of((60.0, 60.0), 5.0, 400.0)
    reference_stretch: Quantity = _known(0.0, -0.1, 0.1)
    """How much the sheet was stretched when the reference was taken."""
    scan_scale: Quantity = _known(1.0, 0.9, 1.1)
    """Lengths in the cloud over the true ones."""
    scan_noise_mm: Range = _of((0.1, 0.1), 0.0, 3.0)
    scan_stale: Range = _of((0.0, 0.0), 0.0, 0.5)
    """How far the deformation went on since the scan, as a share of the whole."""
