"""What the gate learns from: untouched sheets at many deformations, and small touches to tell from them.

A data set has a hundred bends, and a gate that saw only those takes every third new one for a touch. Untouched sheets
need no touch sets, so a thousand more are solved on a coarse mesh, in a family wider than A: A, and in seven of ten
draws one to four dents of any place, height and width besides. Only log(V / V0) is kept, with V0 from the same mesh:
the mesh's own error is the same in both and cancels. Rates are measured on draws of A and of B that nothing learned
from.

A touch is kept as log(V touched / V untouched), which hardly depends on the bend, and so can be put on any of them.

Where a data set is of random devices, its untouched moments are those devices' own, and the sheets that are solved
besides are of other devices of the same kind (:mod:`eitskin_training.gate.moments`). Where it has presses, presses are
what is learned from and what measures.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.grid import SHEET_MM
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_sim.fem.forward import assemble, flat_metric
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.freeform.patterns import CONTRAST
from eitskin_sim.freeform.presses import TouchKind
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene import bend as surfaces
from eitskin_sim.scene.family import BOUNDS, FLAT, SCALED, draw, scaled
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, Sheet
from eitskin_sim.scene.touch_table import DISC, RECTANGLE, gather
from eitskin_training.gate.moments import LEAST_RATIO, moments
from eitskin_training.gate.presses import drawn_presses, probe_presses
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

WEAKEST_CONTRAST: Final = CONTRAST[0]
"""S/m of the weakest touch that is drawn."""

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
        skin: What devices, and the common factor of every frame, are drawn from; None of the nominal device, which
            does not drift.
    """

    train: Array
    choose: Array
    measure: Array
    touches: Array = field(default_factory=lambda: np.empty((0, N_ROWS)))
    probes: tuple[Probe, ...] = ()
    skin: Skin | None = None


def bends_of(data: TrainingData) -> Bends:
    """Return the bends of a data set alone: trained ones teach, held-out ones choose and measure in turn."""
    logs = np.log(np.maximum(data.untouched / data.reference, LEAST_RATIO))
    held_out = np.concatenate(list(data.held_out.values())) if data.held_out else np.array([], dtype=np.intp)
    apart = np.unique(data.deformation[held_out])
    train = logs[np.unique(data.deformation[data.train])]
    return Bends(train, logs[apart[::2]], logs[apart[1::2]], skin=data.skin)


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
    sheets = solved(train, held_out) if data.skin is None else solved_devices(data.skin, train // 2, held_out)
    return replace(
        sheets,
        train=np.concatenate([bends_of(data).train, sheets.train]),
        touches=small_touches(touched_bends, kind=data.touches),
        probes=probes(probed_bends, PROBE_SEED, data.touches),
    )


@cache
def solved(train: int, held_out: int) -> Bends:
    """Return solved bends alone: ``train`` of the wider family, ``held_out`` each of A and B."""
    apart = [untouched_logs(draw(family, held_out, HELD_OUT_SEED)) for family in ("A", "B")]
    return Bends(
        untouched_logs(wide_bends(train, TRAIN_SEED)),
        np.concatenate([logs[::2] for logs in apart]),
        np.concatenate([logs[1::2] for logs in apart]),
    )


@cache
def solved_devices(skin: Skin, train: int, held_out: int) -> Bends:
    """Return what :func:`solved` does, each two sheets of a random device; three, of those to learn from."""
    apart = [
        moments(draw(family, held_out, HELD_OUT_SEED), skin, HELD_OUT_SEED + number)
        for number, family in enumerate(("A", "B"), start=10)
    ]
    return Bends(
        moments(wide_bends(train, TRAIN_SEED), skin, TRAIN_SEED, together=3, late=False),
        # Halves are of whole devices: what chooses has no device in common with what measures.
        np.concatenate([logs[np.arange(len(logs)) // 2 % 2 == 0] for logs in apart]),
        np.concatenate([logs[np.arange(len(logs)) // 2 % 2 == 1] for logs in apart]),
        skin=skin,
    )


def untouched_logs(bends: Iterable[Bend]) -> Array:
    """Return (n, 104) log(V / V0) of untouched sheets."""
    mesh, sheet = scene_mesh(Scene(element_size_mm=COARSE_MM)), Sheet()

    def voltages(bend: Bend | None) -> Array:
        def metric(xy_mm: Array) -> Array:
            return flat_metric(xy_mm) if bend is None else surfaces.metric(bend, sheet, xy_mm)

        return assemble(mesh, sheet, Electrodes(), metric).factorise().voltages()

    flat = voltages(None)
    return np.log(np.array([voltages(bend) for bend in bends]).reshape(-1, N_ROWS) / flat)


def wide_bends(count: int, seed: int) -> list[Bend]:
    """Return bends of the wider family. Some fold through themselves, which changes no voltage and is let pass."""
    rng = np.random.default_rng([seed, 0x71DE])
    found = []
    for _ in range(count):
        bend = Bend(**{name: float(rng.uniform(*bounds)) for name, bounds in BOUNDS.items()})  # type: ignore[arg-type]
        if rng.random() < DENTED:
            bend = replace(bend, bumps_mm=tuple(_dent(rng) for _ in range(int(rng.integers(1, MOST_DENTS + 1)))))
        kind, amplitude = rng.random(2)
        found.append(Bend() if kind < FLAT else scaled(bend, float(amplitude)) if kind < FLAT + SCALED else bend)
    return found


def _dent(rng: np.random.Generator) -> tuple[float, float, float, float]:
    x, y = rng.uniform((5.0, 5.0), (SHEET_MM[0] - 5.0, SHEET_MM[1] - 5.0))
    return float(x), float(y), float(rng.uniform(-DENT_MM, DENT_MM)), float(rng.uniform(*DENT_SIGMA_MM))


@cache
def small_touches(bends: int, each: int = 400, seed: int = TOUCH_SEED, kind: TouchKind = "hard") -> Array:
    """Return (n, 104) log(V touched / V untouched) of touches of 5 to 12 mm, at the flat sheet and other bends.

    Args:
        bends: How many.
        each: Touches at each.
        seed: Of both.
        kind: Faint presses instead, or every second one.
    """
    rng = np.random.default_rng(seed)
    members = [Bend(), *wide_bends(bends - 1, seed)]
    hard = {"hard": each, "press": 0, "both": each // 2}[kind]
    found = []
    for bend in members:
        sets = [_drawn_touches(hard, rng), drawn_presses(each - hard, rng)]
        found += [touch_logs(bend, some) for some in sets if some]
    return np.concatenate(found)


def touch_logs(bend: Bend, sets: Sequence[Array]) -> Array:
    """Return (n, 104) log(V touched / V untouched) of touch sets at a bend, each given by its (p, 7) pieces."""
    sheet = inverted_sheet(bend)
    ratio = set_voltages([sheet], gather(sets))[0] / sheet.untouched_V
    return np.asarray(np.log(ratio[(ratio > 0).all(axis=1)]))


def _drawn_touches(count: int, rng: np.random.Generator) -> list[Array]:
    sets = []
    for _ in range(count):
        size = float(rng.uniform(5.0, 12.0))
        x, y = rng.uniform((size / 2, size / 2), (SHEET_MM[0] - size / 2, SHEET_MM[1] - size / 2))
        contrast = float(np.exp(rng.uniform(*np.log(CONTRAST))))
        if rng.random() < 0.4:
            sets.append(np.array([[DISC, x, y, size, size, 0.0, contrast]]))
        else:
            sets.append(squares([(x, y)], size, contrast)[0])
    return sets


def squares(centres_mm: Iterable[tuple[float, float]], side_mm: float, contrast: float) -> list[Array]:
    """Return touch sets of one square each, as pieces."""
    return [np.array([[RECTANGLE, x, y, side_mm, side_mm, 0.0, contrast]]) for x, y in centres_mm]


def probe_sets(seed: int, each: int = 20) -> dict[str, list[Array]]:
    """Return touch sets by name, of the weakest contrast: squares in the middle of the sheet, and anywhere on it."""
    rng = np.random.default_rng(seed)
    length, width = SHEET_MM
    middle = [(length / 2 + dx, width / 2 + dy) for dx in (-15.0, 0.0, 15.0) for dy in (-10.0, 0.0, 10.0)]
    found = {}
    for side in (10.0, 7.0, 5.0):
        anywhere = [
            (float(x), float(y))
            for x, y in rng.uniform((side / 2, side / 2), (length - side / 2, width - side / 2), (each, 2))
        ]
        found[f"{side:g} mm, middle"] = squares(middle, side, WEAKEST_CONTRAST)
        found[f"{side:g} mm, anywhere"] = squares(anywhere, side, WEAKEST_CONTRAST)
    return found


def probes(bends: int, seed: int, kind: TouchKind = "hard") -> tuple[Probe, ...]:
    """Return touches of a kind at the flat sheet, at ``bends`` bends of A and at as many of B."""
    hard = _probes(bends, seed, False) if kind != "press" else ()
    return hard + (_probes(bends, seed, True) if kind != "hard" else ())


@cache
def _probes(bends: int, seed: int, presses: bool) -> tuple[Probe, ...]:
    sets = probe_presses(seed) if presses else probe_sets(seed)
    table = gather([pieces for group in sets.values() for pieces in group])
    ends = np.cumsum([len(group) for group in sets.values()])
    flat_V = inverted_sheet(Bend()).untouched_V
    families = {"flat": (Bend(),), "A": draw("A", bends, seed), "B": draw("B", bends, seed)}
    found = []
    for family, members in families.items():
        sheets = [inverted_sheet(bend) for bend in members]
        voltages = np.array([set_voltages([sheet], table)[0] for sheet in sheets])
        logs = np.log(np.maximum(voltages / flat_V, 1e-6))
        before = np.log(np.array([sheet.untouched_V for sheet in sheets]) / flat_V)
        for name, group in zip(sets, np.split(logs, ends[:-1], axis=1), strict=True):
            own = np.repeat(before, group.shape[1], axis=0)
            found.append(Probe(name, family, group.reshape(-1, N_ROWS), own))
    return tuple(found)
