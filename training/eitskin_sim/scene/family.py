"""Families of deformations: the paper's one parameter, and those of several independent ones that a robot meets.

::

    paper   q = 0, 1/9 .. 1       one path from flat to a half cylinder, all else follows q
    A       seven parameters, each drawn by itself from the ranges that the skin states
    B       A, and two bumps of 6 mm, inwards or outwards, sigma 12 to 25 mm

A network that sees only the paper's path falls from CC 0.98 to 0.77 on A, and its cloud channel stays idle; so A is
what one trains on and B is kept for tests. Draws are scaled: in three of ten the whole deformation is multiplied by a
uniform amplitude, and one in forty is exactly flat, since a skin is often nearly flat. A draw that folds is drawn
again.
"""

from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import lru_cache
from typing import Final, Literal

import numpy as np

from eitskin_proto.skin.parts import Deformations
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene.folds import check_bend
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend, SceneError

Family = Literal["A", "B"]
"""Which family to draw from."""

SCALED: Final = 0.3
"""Share of draws that are multiplied by an amplitude from 0 to 1."""

FLAT_SHARE: Final = 0.025
"""Share of draws that are exactly flat."""

BUMP_MM: Final = 6.0
"""Height of a bump of family B."""

BUMP_SIGMA_MM: Final = (12.0, 25.0)
"""Width of a bump of family B."""

BUMP_MARGIN_MM: Final = 15.0
"""A bump of family B keeps this distance from the sheet's border."""

OFFSET_MM: Final = 0.5
"""How far the paper-like family's conductive layer lies outside the neutral axis."""


def bounds(deformations: Deformations = PAPER.deformations) -> dict[str, tuple[float, float]]:
    """Return the ranges of family A's uniform and independent draws by the names of :class:`Bend`, in their order."""
    return asdict(deformations)


NO_FAMILY: Final = (
    "the skin's [deformations] are all fixed, so no shapes can be fitted; give them ranges, or send a cloud"
)
"""Why a skin without a family is refused."""


def is_family(deformations: Deformations) -> bool:
    """Return whether a skin states more than one deformation."""
    return any(low < high for low, high in bounds(deformations).values())


def paper_bend(q: float, skin: Skin = PAPER) -> Bend:
    """Return the paper-like deformation at q from 0, flat, to 1, a half cylinder stretched by 19 %.

    Raises:
        ValueError: q is outside 0 to 1.
    """
    if not 0.0 <= q <= 1.0:
        raise ValueError(f"q is {q:g}; it must be from 0 to 1")
    arc = 1.0 + 0.18 * q**2
    curvature = np.deg2rad(180.0 * q) / (skin.outline.size_mm[0] * arc)
    along = arc * (1.0 + OFFSET_MM * float(curvature))
    return Bend(angle_deg=180.0 * q, stretch_along=along, stretch_across=along**-0.25, nonuniformity=0.1 * q)


def paper_bends(count: int = 10, skin: Skin = PAPER) -> tuple[Bend, ...]:
    """Return evenly spaced deformations of the paper-like family, flat first."""
    return tuple(paper_bend(float(q), skin) for q in np.linspace(0.0, 1.0, count))


@lru_cache(maxsize=16)
def draw(family: Family, count: int, seed: int, skin: Skin = PAPER, *, apart: bool = True) -> tuple[Bend, ...]:
    """Return the first ``count`` deformations of a family's sequence; more of them begin with the same ones.

    Args:
        family: "A" or "B".
        count: How many.
        seed: Names the sequence.
        skin: What is bent, and how far.
        apart: Whether none passes through itself. Its metric is as good as others'.

    Raises:
        ValueError: The family is unknown.
    """
    if family not in ("A", "B"):
        raise ValueError(f"family {family!r} is unknown; expected 'A' or 'B'")
    sequence = _sequence(family, skin, np.random.default_rng([seed, ord(family)]), apart)
    return tuple(next(sequence) for _ in range(count))


def _sequence(family: Family, skin: Skin, generator: np.random.Generator, apart: bool) -> Iterator[Bend]:
    sheet = nominal_sheet(skin)
    while True:
        bend = _draw(family, skin, generator)
        try:
            check_bend(bend, sheet, apart=apart)
        except SceneError:
            continue
        yield bend


def _draw(family: Family, skin: Skin, generator: np.random.Generator) -> Bend:
    ranges = bounds(skin.deformations).values()
    angle, axis, skew, twist, along, across, uneven = (float(generator.uniform(*one)) for one in ranges)
    kind, amplitude = generator.random(2)
    bend = Bend(angle, axis, skew, twist, along, across, uneven)
    if family == "B":
        bend = replace(bend, bumps_mm=(_bump(skin, generator), _bump(skin, generator)))
    if kind < FLAT_SHARE:
        return Bend()
    return scaled(bend, float(amplitude)) if kind < FLAT_SHARE + SCALED else bend


def _bump(skin: Skin, generator: np.random.Generator) -> tuple[float, float, float, float]:
    length, width = skin.outline.size_mm
    x, y = generator.uniform((BUMP_MARGIN_MM,) * 2, (length - BUMP_MARGIN_MM, width - BUMP_MARGIN_MM))
    height = BUMP_MM * generator.choice((-1.0, 1.0))
    return float(x), float(y), float(height), float(generator.uniform(*BUMP_SIGMA_MM))


def scaled(bend: Bend, amplitude: float) -> Bend:
    """Return a deformation multiplied by an amplitude: 0 is flat, 1 leaves it; axis and skew keep their meaning."""
    return replace(
        bend,
        angle_deg=amplitude * bend.angle_deg,
        twist_deg=amplitude * bend.twist_deg,
        stretch_along=1.0 + amplitude * (bend.stretch_along - 1.0),
        stretch_across=1.0 + amplitude * (bend.stretch_across - 1.0),
        nonuniformity=amplitude * bend.nonuniformity,
        bumps_mm=tuple((x, y, amplitude * height, sigma) for x, y, height, sigma in bend.bumps_mm),
    )
