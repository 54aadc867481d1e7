"""The conditions of ``eitskin bench verify``: touches, noise, and deviations of the true device.

Touches are those of the trials, and two more kinds: the paper's phantoms, moved by up to half a pixel, at drawn
deformations, and fingers laid across the sheet's sides, turned by any angle. True sheets are solved on a separate mesh.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.model.stillness import MOST_FUSED
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.device import Device, draw_device
from eitskin_sim.evaluation.device_runs import PRESS_BORDER_MM, PRESS_MM, SINGLE_MM
from eitskin_sim.evaluation.mismatch import IDEAL, LAB, Mismatch
from eitskin_sim.evaluation.trials import TouchProfile
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.measurement.noise import NOISES, Kind
from eitskin_sim.scene.family import Family
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Bend, Phantom, Scene, Touch
from eitskin_sim.scene.scene import load_phantoms
from eitskin_sim.scene.shapes import Ellipse, Rect
from eitskin_sim.scene.shift import shifted
from eitskin_tools.command_line import files
from eitskin_tools.evaluation.verified.untouched_baseline import BASELINE_FRAMES

Array = npt.NDArray[np.float64]

ELEMENT_MM: Final = 2.0
"""Of the true sheets' mesh, whose lines are not those of the models'."""

SEED: Final = 61_007
"""Names touches, noise and scans; deformations are those of the trials."""

UNIT_COUNTS: Final = (1, 6)
"""Least and most touched units of a map."""

FAMILIES: Final[tuple[Family, ...]] = ("A", "B")
"""Of deformations."""

LARGE_GENTLE_TOUCHES: Final = ((3.0, 16.0), (2.0, 16.0), (2.0, 20.0))
"""Contrasts and sides of gentle touches that are larger than a network of hard ones shows them."""

OPPOSITE_MM: Final = 12.0
"""Side of each of two touches of opposite signs,"""

OPPOSITE_CONTRASTS: Final = (20.0, 0.2)
"""and their contrasts."""

ACROSS_SEED: Final = 61_017
"""Names the touches' places, sizes and angles."""

LONG_MM: Final = (28.0, 42.0)
WIDE_MM: Final = (12.0, 16.0)
"""Axes, from and to."""

ACROSS_MARGIN_MM: Final = 3.0
"""To the sheet's border."""

SHIFT_PX: Final = 0.5
"""A touch on the grid of pixels is easier than it will be."""

PAPER_SEED: Final = 61_011
"""Names which phantom is taken, and how it is moved."""


Draw = Callable[[int, int], list[Phantom]]
"""From a number of deformations and touch sets at each to as many phantoms, deformation after deformation."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One row: touches, and how the true device differs."""

    name: str
    phantoms: Draw
    mismatch: Mismatch = IDEAL
    noise: Kind = "N2"
    missing: bool = False
    """One electrode is gone, another one for each map."""
    at_rest: int = 0
    """Frames of each deformation that are seen untouched first."""
    fused: int = 1
    """Frames of each touch at rest that are averaged."""


def conditions() -> list[Condition]:
    """Return the rows: those of touched units, those of touches anywhere, and those seen untouched before."""
    hard_lab = replace(LAB, contrast=None, border_mm=0.0)
    return [
        *(Condition(f"1 to 6 units, {noise}", _units(), noise=noise) for noise in NOISES),
        Condition("one electrode gone", _units(), missing=True),
        *(Condition(f"contrast {contrast:g}", _units(contrast)) for contrast in (3.0, 10.0, 200.0)),
        Condition("soft borders of 2 mm", _units(border_mm=2.0)),
        Condition("scan noise 1 mm", _units(), Mismatch(scan_noise_mm=1.0)),
        Condition("lab device, hard touches", _units(), hard_lab),
        Condition("seen at rest: lab device, hard touches", _units(), hard_lab, at_rest=BASELINE_FRAMES),
        *(Condition(f"paper-like touches, {noise}", paper_like, noise=noise) for noise in ("N2", "N3")),
        Condition("singles of 10 mm", _singles()),
        *(Condition(f"pairs 10 mm apart, {family}", _pairs(family)) for family in FAMILIES),
        *(Condition(f"opposite signs {gap:g} mm apart", _opposite(gap)) for gap in (20.0, 50.0)),
        *(Condition(f"presses of contrast {contrast:g}", _presses(contrast)) for contrast in (0.4, 0.6)),
        Condition("lab-like, singles", _singles(), LAB),
        *(Condition(f"lab-like, presses of contrast {contrast:g}", _presses(contrast), LAB) for contrast in (0.4, 0.6)),
        *(Condition(f"contrast {contrast:g}, singles", _singles(contrast)) for contrast in (5.0, 3.0, 2.0, 1.5)),
        *(
            Condition(f"across, of contrast {contrast:g}", _across(contrast, border))
            for contrast, border in ((50.0, 0.0), (0.4, PRESS_BORDER_MM))
        ),
        *(
            Condition(f"contrast {contrast:g}, of {side:g} mm", _singles(contrast, side))
            for contrast, side in LARGE_GENTLE_TOUCHES
        ),
        *_seen_at_rest(),
        *(
            Condition(
                f"at rest for {MOST_FUSED} frames: {name}", phantoms, mismatch, at_rest=MOST_FUSED, fused=MOST_FUSED
            )
            for name, phantoms, mismatch in (
                ("contrast 2, singles", _singles(2.0), IDEAL),
                ("lab-like, presses of contrast 0.6", _presses(0.6), LAB),
            )
        ),
    ]


def _seen_at_rest() -> list[Condition]:
    """Return rows of deformations that were seen untouched before, for as long as the stream does."""
    rows = {
        "paper-like touches": (paper_like, IDEAL),
        "singles of 10 mm": (_singles(), IDEAL),
        **{f"pairs 10 mm apart, {family}": (_pairs(family), IDEAL) for family in FAMILIES},
        "presses of contrast 0.6": (_presses(0.6), IDEAL),
        "contrast 2, singles": (_singles(2.0), IDEAL),
        "lab-like, singles": (_singles(), LAB),
        "lab-like, presses of contrast 0.4": (_presses(0.4), LAB),
        "lab-like, presses of contrast 0.6": (_presses(0.6), LAB),
    }
    return [
        Condition(f"seen at rest: {name}", phantoms, mismatch, at_rest=BASELINE_FRAMES)
        for name, (phantoms, mismatch) in rows.items()
    ]


def _units(contrast: float = 50.0, border_mm: float = 0.0) -> Draw:
    """Return what draws one to six touched units, the same whatever their contrast and border."""

    def draw(deformations: int, each: int) -> list[Phantom]:
        found, grid = [], PAPER.grid
        for number, bend in enumerate(trials.deformations_of(deformations, "A")):
            rng = np.random.default_rng([SEED, number, *UNIT_COUNTS])
            for index in range(each):
                count = int(rng.integers(UNIT_COUNTS[0], UNIT_COUNTS[1] + 1))
                touches = []
                for unit in np.sort(rng.choice(grid.n_units, count, replace=False)).tolist():
                    row, column = divmod(unit, grid.units[1])
                    rect = Rect(*grid.unit_rect_mm(column, row))
                    touches.append(Touch((rect,), contrast=contrast, border_mm=border_mm))
                found.append(Phantom(f"A{number}.{index}", nominal_scene(PAPER, bend, tuple(touches)), "units"))
        return found

    return draw


def _singles(contrast: float = 50.0, side_mm: float = SINGLE_MM) -> Draw:
    return lambda deformations, each: trials.single(
        side_mm, deformations, each, "A", TouchProfile(contrast) if contrast != 50.0 else trials.HARD_SQUARE
    )


def _across(contrast: float, border_mm: float) -> Draw:
    return lambda deformations, each: across(contrast, border_mm, deformations, each)


def _pairs(family: Family) -> Draw:
    return lambda deformations, each: trials.pair(10.0, deformations, each, family)


def _opposite(gap_mm: float) -> Draw:
    return lambda deformations, each: [
        replace(one, scene=replace(one.scene, touches=tuple(map(_of_sign, one.scene.touches, OPPOSITE_CONTRASTS))))
        for one in trials.pair(gap_mm, deformations, each, side_mm=OPPOSITE_MM)
    ]


def _of_sign(touch: Touch, contrast: float) -> Touch:
    return replace(touch, contrast=contrast)


def _presses(contrast: float) -> Draw:
    softness = TouchProfile(contrast, PRESS_BORDER_MM, disc=True)
    return lambda deformations, each: trials.single(PRESS_MM, deformations, each, "A", softness)


def paper_like(deformations: int, each: int) -> list[Phantom]:
    """Return ``each`` phantoms at every deformation of family A."""
    known = load_phantoms(files.find("paper_mm", files.PHANTOMS))
    found = []
    for number, bend in enumerate(trials.deformations_of(deformations, "A")):
        rng = np.random.default_rng([PAPER_SEED, number])
        for index in range(each):
            one = shifted(known[(number * each + index) % len(known)], SHIFT_PX, rng)
            found.append(replace(one, name=f"A{number}.{index}", scene=replace(one.scene, bend=bend)))
    return found


def across(contrast: float, border_mm: float, deformations: int, each: int) -> list[Phantom]:
    """Return ``each`` ellipses, one a map, at every deformation of family A.

    Args:
        contrast: Of each.
        border_mm: Width of its graded border; 0 is sharp.
        deformations: How many deformations.
        each: Maps at each.
    """
    found, size = [], np.array(PAPER.grid.size_mm)
    for number, bend in enumerate(trials.deformations_of(deformations, "A")):
        rng = np.random.default_rng([ACROSS_SEED, number])
        for index in range(each):
            along, wide, angle = rng.uniform(*LONG_MM), rng.uniform(*WIDE_MM), rng.uniform(0.0, 180.0)
            reach = (along + border_mm) / 2.0 + ACROSS_MARGIN_MM
            x, y = rng.uniform(reach, size - reach)
            touch = Touch((Ellipse(x, y, along, wide, angle),), contrast=contrast, border_mm=border_mm)
            found.append(Phantom(f"A{number}.{index}", nominal_scene(PAPER, bend, (touch,)), "area"))
    return found


@lru_cache(maxsize=4096)
def volts(scene: Scene) -> Array:
    """Return the (104,) V of a scene."""
    return solve_scene(replace(scene, element_size_mm=ELEMENT_MM)).voltages


def device_of(mismatch: Mismatch, number: int) -> Device:
    """Return the device of a deformation's number: the same draws, whatever the mismatch."""
    return draw_device(mismatch, 0, number)


def cloud_of(device: Device, bend: Bend, number: int) -> Array:
    """Return the (3, rows, columns) mm scan of a deformation."""
    cloud = device.cloud(bend, np.random.default_rng([SEED, number]))
    assert cloud is not None
    return cloud
