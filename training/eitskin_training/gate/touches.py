"""Touches for the gate's training and for measuring its misses.

A touch is kept as log(V touched / V untouched), which hardly depends on the bend, and so can be put on any of them.
Where a data set has presses, faint presses are learned from and measured (:mod:`eitskin_training.gate.presses`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.arrays import Array
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene.family import FLAT_SHARE, SCALED, bounds, draw, scaled
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import DISC, RECTANGLE, gather
from eitskin_training.gate.presses import drawn_presses, probe_presses

DENTED_SHARE: Final = 0.7
MAX_DENTS: Final = 4
DENT_MM: Final = 7.5
DENT_SIGMA_MM: Final = (10.0, 30.0)
"""Share of the wider family that has dents, how many at most, their greatest height and their width."""


def wide_bends(count: int, seed: int, skin: Skin) -> list[Bend]:
    """Return bends of the wider family. Some fold through themselves, which changes no voltage and is let pass."""
    rng = np.random.default_rng([seed, 0x71DE])
    found = []
    for _ in range(count):
        bend = Bend(**{name: float(rng.uniform(*one)) for name, one in bounds(skin.deformations).items()})  # type: ignore[arg-type]
        if rng.random() < DENTED_SHARE:
            bend = replace(bend, bumps_mm=tuple(_dent(rng, skin) for _ in range(int(rng.integers(1, MAX_DENTS + 1)))))
        kind, amplitude = rng.random(2)
        found.append(
            Bend() if kind < FLAT_SHARE else scaled(bend, float(amplitude)) if kind < FLAT_SHARE + SCALED else bend
        )
    return found


def _dent(rng: np.random.Generator, skin: Skin) -> tuple[float, float, float, float]:
    length, width = skin.outline.size_mm
    x, y = rng.uniform((5.0, 5.0), (length - 5.0, width - 5.0))
    return float(x), float(y), float(rng.uniform(-DENT_MM, DENT_MM)), float(rng.uniform(*DENT_SIGMA_MM))


PROBE_SEED: Final = 703
TOUCH_SEED: Final = 704
"""Sequences that no data set uses."""

CACHED_RESULTS: Final = 4
"""Results that are kept while the process runs, of each kind: of a few skins."""


@dataclass(frozen=True, slots=True)
class Probe:
    """Touches at bends that nothing learned from.

    Args:
        name: What touches: "10 mm, middle".
        family: "flat", "A" or "B".
        logs: (n, 104) log(V / V0).
        before: (n, 104) the same of each one's sheet before it was touched.
    """

    name: str
    family: str
    logs: Array
    before: Array


TOUCHES_PER_BEND: Final = 400


@lru_cache(maxsize=CACHED_RESULTS)
def small_touches(bends: int, skin: Skin, kind: TouchKind = "raise") -> Array:
    """Return (n, 104) log(V touched / V untouched) of touches of 5 to 12 mm, at the flat sheet and other bends.

    Args:
        bends: How many.
        skin: Of the sheet.
        kind: "lower" for faint presses instead, "both" for every second one.
    """
    rng = np.random.default_rng(TOUCH_SEED)
    members = [Bend(), *wide_bends(bends - 1, TOUCH_SEED, skin)]
    hard = {"raise": TOUCHES_PER_BEND, "lower": 0, "both": TOUCHES_PER_BEND // 2}[kind]
    found = []
    for bend in members:
        sets = [_drawn_touches(hard, rng, skin), drawn_presses(TOUCHES_PER_BEND - hard, rng, skin)]
        found += [touch_logs(bend, some, skin) for some in sets if some]
    return np.concatenate(found)


def touch_logs(bend: Bend, sets: Sequence[Array], skin: Skin) -> Array:
    """Return (n, 104) log(V touched / V untouched) of touch sets at a bend, each given by its (p, 7) pieces."""
    sheet = inverted_sheet(bend, skin=skin)
    ratio = set_voltages([sheet], gather(sets), skin=skin)[0] / sheet.untouched_V
    return np.asarray(np.log(ratio[(ratio > 0).all(axis=1)]))


def _contrast(rng: np.random.Generator, skin: Skin) -> float:
    """Return the conductivity inside a random touch over the sheet's, of those that touch this skin."""
    touches = skin.touches
    ranges = [touches.raising_contrast] * touches.higher + [touches.lowering_contrast] * touches.lower
    one = ranges[0] if len(ranges) == 1 else ranges[int(rng.integers(len(ranges)))]
    return float(np.exp(rng.uniform(*np.log(one))))


def weakest_contrast(skin: Skin) -> float:
    """Return the contrast of the weakest touch that is drawn."""
    touches = skin.touches
    return touches.raising_contrast[0] if touches.higher else touches.lowering_contrast[1]


def _drawn_touches(count: int, rng: np.random.Generator, skin: Skin) -> list[Array]:
    sets = []
    length, width = skin.outline.size_mm
    for _ in range(count):
        size = float(rng.uniform(5.0, 12.0))
        x, y = rng.uniform((size / 2, size / 2), (length - size / 2, width - size / 2))
        contrast = _contrast(rng, skin)
        if rng.random() < 0.4:
            sets.append(np.array([[DISC, x, y, size, size, 0.0, contrast]]))
        else:
            sets.append(squares([(x, y)], size, contrast)[0])
    return sets


def squares(centres_mm: Iterable[tuple[float, float]], side_mm: float, contrast: float) -> list[Array]:
    """Return touch sets of one square each, as pieces."""
    return [np.array([[RECTANGLE, x, y, side_mm, side_mm, 0.0, contrast]]) for x, y in centres_mm]


def probe_sets(seed: int, skin: Skin) -> dict[str, list[Array]]:
    """Return touch sets by name, of the weakest contrast: squares in the middle of the sheet, and anywhere on it."""
    rng = np.random.default_rng(seed)
    length, width = skin.outline.size_mm
    contrast = weakest_contrast(skin)
    middle = [(length / 2 + dx, width / 2 + dy) for dx in (-15.0, 0.0, 15.0) for dy in (-10.0, 0.0, 10.0)]
    found = {}
    for side in (10.0, 7.0, 5.0):
        anywhere = [
            (float(x), float(y))
            for x, y in rng.uniform((side / 2, side / 2), (length - side / 2, width - side / 2), (20, 2))
        ]
        found[f"{side:g} mm, middle"] = squares(middle, side, contrast)
        found[f"{side:g} mm, anywhere"] = squares(anywhere, side, contrast)
    return found


def probes(bends: int, seed: int, skin: Skin, kind: TouchKind = "raise") -> tuple[Probe, ...]:
    """Return touches of a kind at the flat sheet, at ``bends`` bends of A and at as many of B."""
    hard = _probes(bends, seed, skin, False) if kind != "lower" else ()
    return hard + (_probes(bends, seed, skin, True) if kind != "raise" else ())


@lru_cache(maxsize=CACHED_RESULTS)
def _probes(bends: int, seed: int, skin: Skin, presses: bool) -> tuple[Probe, ...]:
    sets = probe_presses(seed, skin) if presses else probe_sets(seed, skin)
    table = gather([pieces for group in sets.values() for pieces in group])
    ends = np.cumsum([len(group) for group in sets.values()])
    flat_V = inverted_sheet(Bend(), skin=skin).untouched_V
    families = {"flat": (Bend(),), "A": draw("A", bends, seed, skin), "B": draw("B", bends, seed, skin)}
    found = []
    for family, members in families.items():
        sheets = [inverted_sheet(bend, skin=skin) for bend in members]
        voltages = np.array([set_voltages([sheet], table, skin=skin)[0] for sheet in sheets])
        logs = np.log(np.maximum(voltages / flat_V, 1e-6))
        before = np.log(np.array([sheet.untouched_V for sheet in sheets]) / flat_V)
        for name, group in zip(sets, np.split(logs, ends[:-1], axis=1), strict=True):
            own = np.repeat(before, group.shape[1], axis=0)
            found.append(Probe(name, family, group.reshape(-1, N_ROWS), own))
    return tuple(found)
