"""The values that a scene is made of: sheet, electrodes, bend, touches, each with the paper's value as its default.

Lengths are mm in the flat sheet's frame (x along its length, y along its width, origin at a corner); angles are
degrees. Names and units are those of the scene's JSON, which :mod:`eitskin_sim.scene.scene` reads and checks. Another
skin's sheet and electrodes come from :mod:`eitskin_sim.scene.nominal`.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from eitskin_proto.errors import SkinError
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.arrays import Array
from eitskin_sim.scene.shapes import Shape

MIN_LOG_CONTRAST: Final = 1e-6
"""A touch whose contrast is nearer to 1 than this changes nothing of the sheet that anybody could measure."""


class SceneError(SkinError, ValueError):
    """An invalid scene, or one that cannot be solved: what was found, what was expected, and where."""


@dataclass(frozen=True, slots=True)
class SmoothField:
    """A smooth random field over the flat sheet; :func:`eitskin_sim.scene.layer.smooth_field` evaluates it.

    Equal fields are equal everywhere: whatever mesh asks, and whatever they are used for.
    """

    rms: float
    """Standard deviation at every point, over seeds."""
    correlation_mm: float
    """l of its correlation exp(-r^2 / (2 l^2))."""
    seed: int


@dataclass(frozen=True, slots=True)
class LaterChanges:
    """The changes of the layer's conductivity since the reference; all three multiply it."""

    factor: float = 1.0
    """Of the whole sheet."""
    gradient_rms: float = 0.0
    """Rms over the sheet of a tilt of log conductivity, linear in place and of mean zero."""
    field: SmoothField | None = None
    """Of log conductivity."""
    seed: int = 0
    """Draws the direction of the tilt."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """The conductive layer before it is bent (paper sections III and V.A), and in what it is not ideal."""

    size_mm: tuple[float, float] = PAPER.outline.size_mm
    thickness_mm: float = 2.0
    conductivity_S_per_m: float = 1.0
    gauge_factor: float = 0.0
    """k: where the sheet is stretched, its conductivity is multiplied by (local area stretch)^-k."""
    field: SmoothField | None = None
    """Unevenness of log conductivity that was there when the reference was taken."""
    late: LaterChanges | None = None
    """The change since the reference."""


@dataclass(frozen=True, slots=True)
class Electrodes:
    """Sixteen electrodes on the border (paper section III)."""

    contact: Literal["patch", "edge"] = "patch"
    size_mm: float | tuple[float, ...] = 4.0
    """Of all, or of each of the 16."""
    contact_impedance_ohm_m2: float | tuple[float, ...] = 1e-4
    """Of all, or of each of the 16."""
    arc_length_mm: tuple[float, ...] = tuple(PAPER.arc_length_mm.tolist())
    """Centres by arc length, counter-clockwise from the corner (0, 0)."""

    def sizes_mm(self) -> Array:
        """Return the (16,) sizes."""
        return _of_each(self.size_mm)

    def impedances_ohm_m2(self) -> Array:
        """Return the (16,) contact impedances."""
        return _of_each(self.contact_impedance_ohm_m2)


def _of_each(value: float | tuple[float, ...]) -> Array:
    return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (N_ELECTRODES,)))


@dataclass(frozen=True, slots=True)
class Bend:
    """How the sheet is stretched, rolled, twisted and dented; :mod:`eitskin_sim.scene.bend` gives the surface."""

    angle_deg: float = 0.0
    axis_deg: float = 0.0
    skew: float = 0.0
    twist_deg: float = 0.0
    stretch_along: float = 1.0
    stretch_across: float = 1.0
    nonuniformity: float = 0.0
    bumps_mm: tuple[tuple[float, float, float, float], ...] = ()
    """x, y, height and sigma of each Gaussian."""


@dataclass(frozen=True, slots=True)
class Touch:
    """A place of the sheet that conducts otherwise: better, as under the paper's touches, or worse, as under a press.

    The border is sharp, or graded: the logarithm of the conductivity then runs linearly over ``border_mm`` about the
    outline, which is its contour of half height. A graded touch multiplies what lies under it; of sharp ones that
    overlap the later holds.
    """

    shapes: tuple[Shape, ...]
    conductivity_S_per_m: float = 50.0
    contrast: float | None = None
    """Conductivity over the sheet's; where it is given, it stands for ``conductivity_S_per_m``."""
    border_mm: float = 0.0
    """Width of the graded border; 0 is sharp."""
    dent_mm: float = 0.0
    """How deep the sheet is pressed in, with a wall of sigma ``DENT_WALL_MM``; it stretches the sheet there."""

    def factor(self, sheet_S_per_m: float) -> float:
        """Return the conductivity inside over the sheet's."""
        return self.conductivity_S_per_m / sheet_S_per_m if self.contrast is None else self.contrast

    def inside_S_per_m(self, sheet_S_per_m: float) -> float:
        """Return the conductivity inside."""
        return self.conductivity_S_per_m if self.contrast is None else self.contrast * sheet_S_per_m

    def is_alike(self, sheet_S_per_m: float) -> bool:
        """Return whether the conductivity inside is the sheet's."""
        return abs(math.log(self.factor(sheet_S_per_m))) < MIN_LOG_CONTRAST

    def is_hole(self, sheet_S_per_m: float) -> bool:
        """Return whether the sheet is as untouched here: of sharp touches under it, this one takes a piece out."""
        return self.is_alike(sheet_S_per_m) and not self.border_mm and not self.dent_mm

    def lowers(self, sheet_S_per_m: float) -> bool:
        """Return whether it lowers conductance: by its contrast, or by a dent alone, which stretches the sheet."""
        return self.is_alike(sheet_S_per_m) or self.factor(sheet_S_per_m) < 1.0


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that the voltages depend on."""

    sheet: Sheet = field(default_factory=Sheet)
    electrodes: Electrodes = field(default_factory=Electrodes)
    bend: Bend = field(default_factory=Bend)
    touches: tuple[Touch, ...] = ()
    current_A: float = 1.0
    element_size_mm: float = 1.5

    def untouched(self) -> "Scene":
        """Return the same scene without its touches."""
        return replace(self, touches=())

    @property
    def touch_kind(self) -> TouchKind:
        """Which way the touches change conductance, holes in them aside; without any, as the paper's do."""
        sheet = self.sheet.conductivity_S_per_m
        lower = {touch.lowers(sheet) for touch in self.touches if not touch.is_hole(sheet)}
        return "both" if len(lower) == 2 else "lower" if lower == {True} else "raise"

    def reference(self) -> "Scene":
        """Return the same device when its reference was taken: flat, untouched, and without what came late."""
        return replace(self, sheet=replace(self.sheet, late=None), bend=Bend(), touches=())


@dataclass(frozen=True, slots=True)
class Phantom:
    """A named scene and how its truth is drawn on the grid."""

    name: str
    scene: Scene
    truth: Literal["units", "area"]
