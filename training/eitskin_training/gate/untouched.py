"""What the gate learns from: untouched sheets at many deformations, and small touches to tell from them.

A data set has a hundred bends, and a gate that saw only those takes every third new one for a touch. Untouched sheets
need no touch sets, so a thousand more are solved on a coarse mesh, in a family wider than A: A, and in seven of ten
draws one to four dents of any place, height and width besides. Only log(V / V0) is kept, with V0 from the same mesh:
the mesh's own error is the same in both and cancels. Rates are measured on draws of A and of B that nothing learned
from.

A touch is kept as log(V touched / V untouched), which hardly depends on the bend, and so can be put on any of them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.freeform.sheet import InvertedSheet, inverted_sheet
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene import bend as surfaces
from eitskin_sim.scene.family import FLAT, SCALED, bounds, draw, scaled
from eitskin_sim.scene.nominal import flat_metric_of, nominal_electrodes, nominal_scene, nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import DISC, RECTANGLE, TouchTable, gather
from eitskin_training.samples.batches import TrainingData

COARSE_MM: Final = 4.5
"""Element size: 0.05 s a bend, and log(V / V0) to 2e-4."""

TRAIN_SEED: Final = 701
HELD_OUT_SEED: Final = 702
PROBE_SEED: Final = 703
TOUCH_SEED: Final = 704
"""Sequences that no data set uses."""

DENTED: Final = 0.7
MOST_DENTS: Final = 4
DENT_MM: Final = 7.5
DENT_SIGMA_MM: Final = (10.0, 30.0)
"""Share of the wider family that has dents, how many at most, their greatest height and their width."""

KEPT: Final = 4
"""Results that are kept while the process runs, of each kind: of a few skins."""

Array = npt.NDArray[np.float64]


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


@dataclass(frozen=True, slots=True)
class Bends:
    """log(V / V0) of untouched sheets, and touches.

    Args:
        train: (n, 104) to learn from.
        choose: (c, 104) that choose a threshold.
        measure: (m, 104) that measure what it does.
        touches: (t, 104) log(V touched / V untouched) of small touches, to learn from.
        probes: Touches that measure what is missed.
    """

    train: Array
    choose: Array
    measure: Array
    touches: Array = field(default_factory=lambda: np.empty((0, N_ROWS)))
    probes: tuple[Probe, ...] = ()


def bends_of(data: TrainingData) -> Bends:
    """Return the bends of a data set alone: trained ones teach, held-out ones choose and measure in turn."""
    logs = np.log(data.untouched / data.reference)
    held_out = np.concatenate(list(data.held_out.values())) if data.held_out else np.array([], dtype=np.intp)
    apart = np.unique(data.deformation[held_out])
    return Bends(logs[np.unique(data.deformation[data.train])], logs[apart[::2]], logs[apart[1::2]])


def solved_bends(
    data: TrainingData, train: int = 900, held_out: int = 100, touched_bends: int = 8, probed_bends: int = 3
) -> Bends:
    """Return a data set's bends and many more, and touches.

    Args:
        data: The data set; its bends kept apart are left to other measurements.
        train: Bends of the wider family to solve for learning.
        held_out: Bends to solve of A, and as many of B, half of which choose and half measure.
        touched_bends: Bends at which small touches are solved for learning.
        probed_bends: Bends of A, and as many of B, at which touches measure what is missed.
    """
    found = solved(train, held_out, data.skin)
    return replace(
        found,
        train=np.concatenate([bends_of(data).train, found.train]),
        touches=small_touches(touched_bends, data.skin),
        probes=probes(probed_bends, PROBE_SEED, data.skin),
    )


@lru_cache(maxsize=KEPT)
def solved(train: int, held_out: int, skin: Skin) -> Bends:
    """Return solved bends alone: ``train`` of the wider family, ``held_out`` each of A and B."""
    apart = [untouched_logs(draw(family, held_out, HELD_OUT_SEED, skin), skin) for family in ("A", "B")]
    return Bends(
        untouched_logs(wide_bends(train, TRAIN_SEED, skin), skin),
        np.concatenate([logs[::2] for logs in apart]),
        np.concatenate([logs[1::2] for logs in apart]),
    )


def untouched_logs(bends: Iterable[Bend], skin: Skin) -> Array:
    """Return (n, 104) log(V / V0) of untouched sheets."""
    mesh, sheet = scene_mesh(nominal_scene(skin, element_size_mm=COARSE_MM)), nominal_sheet(skin)
    electrodes, flat_metric = nominal_electrodes(skin), flat_metric_of(skin)

    def voltages(bend: Bend | None) -> Array:
        def metric(xy_mm: Array) -> Array:
            return flat_metric(xy_mm) if bend is None else surfaces.metric(bend, sheet, xy_mm)

        return assemble(mesh, sheet, electrodes, metric).factorise().voltages()

    flat = voltages(None)
    return np.log(np.array([voltages(bend) for bend in bends]).reshape(-1, N_ROWS) / flat)


def wide_bends(count: int, seed: int, skin: Skin) -> list[Bend]:
    """Return bends of the wider family. Some fold through themselves, which changes no voltage and is let pass."""
    rng = np.random.default_rng([seed, 0x71DE])
    found = []
    for _ in range(count):
        bend = Bend(**{name: float(rng.uniform(*one)) for name, one in bounds(skin.deformations).items()})  # type: ignore[arg-type]
        if rng.random() < DENTED:
            bend = replace(bend, bumps_mm=tuple(_dent(rng, skin) for _ in range(int(rng.integers(1, MOST_DENTS + 1)))))
        kind, amplitude = rng.random(2)
        found.append(Bend() if kind < FLAT else scaled(bend, float(amplitude)) if kind < FLAT + SCALED else bend)
    return found


def _dent(rng: np.random.Generator, skin: Skin) -> tuple[float, float, float, float]:
    length, width = skin.outline.size_mm
    x, y = rng.uniform((5.0, 5.0), (length - 5.0, width - 5.0))
    return float(x), float(y), float(rng.uniform(-DENT_MM, DENT_MM)), float(rng.uniform(*DENT_SIGMA_MM))


@lru_cache(maxsize=KEPT)
def small_touches(bends: int, skin: Skin, each: int = 400, seed: int = TOUCH_SEED) -> Array:
    """Return (n, 104) log(V touched / V untouched) of touches of 5 to 12 mm, at the flat sheet and other bends."""
    rng = np.random.default_rng(seed)
    members = [Bend(), *wide_bends(bends - 1, seed, skin)]
    return np.concatenate([touch_logs(bend, _drawn_touches(each, rng, skin), skin) for bend in members])


def touch_logs(bend: Bend, sets: Sequence[Array], skin: Skin) -> Array:
    """Return (n, 104) log(V touched / V untouched) of touch sets at a bend, each given by its (p, 7) pieces."""
    sheet = _inverted(bend, skin)
    ratio = _touched_V(sheet, gather(sets), skin) / sheet.untouched_V
    return np.asarray(np.log(ratio[(ratio > 0).all(axis=1)]))


def _inverted(bend: Bend, skin: Skin) -> InvertedSheet:
    return inverted_sheet(bend, skin=skin)


def _touched_V(sheet: InvertedSheet, table: TouchTable, skin: Skin) -> Array:
    """Return (s, 104) V of touch sets on a sheet."""
    return np.asarray(set_voltages([sheet], table, skin=skin)[0])


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


def probe_sets(seed: int, skin: Skin, each: int = 20) -> dict[str, list[Array]]:
    """Return touch sets by name, of the weakest contrast: squares in the middle of the sheet, and anywhere on it."""
    rng = np.random.default_rng(seed)
    length, width = skin.outline.size_mm
    contrast = weakest_contrast(skin)
    middle = [(length / 2 + dx, width / 2 + dy) for dx in (-15.0, 0.0, 15.0) for dy in (-10.0, 0.0, 10.0)]
    found = {}
    for side in (10.0, 7.0, 5.0):
        anywhere = [
            (float(x), float(y))
            for x, y in rng.uniform((side / 2, side / 2), (length - side / 2, width - side / 2), (each, 2))
        ]
        found[f"{side:g} mm, middle"] = squares(middle, side, contrast)
        found[f"{side:g} mm, anywhere"] = squares(anywhere, side, contrast)
    return found


@lru_cache(maxsize=KEPT)
def probes(bends: int, seed: int, skin: Skin) -> tuple[Probe, ...]:
    """Return touches at the flat sheet, at ``bends`` bends of A and at as many of B."""
    sets = probe_sets(seed, skin)
    table = gather([pieces for group in sets.values() for pieces in group])
    ends = np.cumsum([len(group) for group in sets.values()])
    flat_V = _inverted(Bend(), skin).untouched_V
    families = {"flat": (Bend(),), "A": draw("A", bends, seed, skin), "B": draw("B", bends, seed, skin)}
    found = []
    for family, members in families.items():
        sheets = [_inverted(bend, skin) for bend in members]
        voltages = np.array([_touched_V(sheet, table, skin) for sheet in sheets])
        logs = np.log(np.maximum(voltages / flat_V, 1e-6))
        before = np.log(np.array([sheet.untouched_V for sheet in sheets]) / flat_V)
        for name, group in zip(sets, np.split(logs, ends[:-1], axis=1), strict=True):
            own = np.repeat(before, group.shape[1], axis=0)
            found.append(Probe(name, family, group.reshape(-1, N_ROWS), own))
    return tuple(found)
