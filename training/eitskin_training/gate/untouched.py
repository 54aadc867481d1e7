"""The gate's training data: untouched sheets at many deformations, and small touches.

A data set has a hundred bends, and a gate that saw only those takes every third new one for a touch. Untouched sheets
need no touch sets, so a thousand more are solved on a coarse mesh, in a family wider than A: A, and in seven of ten
draws one to four dents of any place, height and width. Only log(V / V0) is kept, with V0 from the same mesh: the mesh's
own error is the same in both and cancels. Rates are measured on draws of A and of B that are not used for training.

Where a data set is of random devices, untouched moments are those of random devices of its skin
(:mod:`eitskin_training.gate.moments`): the moments for training, for the threshold and for measuring share neither bend
nor device. Those for the threshold and for measuring are drawn from A and B alone.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from eitskin_proto.sensor.row_gaussian import log_of_ratio
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene import bend as surfaces
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import flat_metric_of, nominal_electrodes, nominal_scene, nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_training.gate.moments import COARSE_MM, drawn_moments, moments
from eitskin_training.gate.touches import PROBE_SEED, Probe, probes, small_touches, wide_bends

if TYPE_CHECKING:
    from eitskin_training.samples.batches import TrainingData

TRAIN_SEED: Final = 701
HELD_OUT_SEED: Final = 702
CHOICE_SEED: Final = 705
"""Sequences that no data set uses."""

LEARNED_DEVICES: Final = 2000
CHOOSING_DEVICES: Final = 300
MOMENTS_PER_DEVICE: Final = 8
"""Random devices that are learned from and that choose a threshold, and the moments of each."""

APART: Final = 100
"""Bends solved of A, and as many of B, half of which choose and half measure; of devices, all measure."""

TOUCHED_BENDS: Final = 8
"""At which small touches are solved for learning."""

PROBED_BENDS: Final = 3
"""Of A, and as many of B, at which touches measure what is missed."""

CACHED_RESULTS: Final = 4
"""Results that are kept while the process runs, of each kind: of a few skins."""


@dataclass(frozen=True, slots=True)
class Bends:
    """log(V / V0) of untouched sheets, and touches.

    Args:
        train: (n, 104) to learn from.
        choose: (c, 104) that choose a threshold.
        measure: (m, 104) that measure what it does.
        touches: (t, 104) log(V touched / V untouched) of small touches, to learn from.
        probes: Touches that measure what is missed.
        devices: What devices, and the common factor of every frame, are drawn from; None of the nominal device, which
            does not drift.
    """

    train: Array
    choose: Array
    measure: Array
    touches: Array = field(default_factory=lambda: np.empty((0, N_ROWS)))
    probes: tuple[Probe, ...] = ()
    devices: Skin | None = None


def bends_of(data: "TrainingData") -> Bends:
    """Return the bends of a data set alone: trained ones teach, held-out ones choose and measure in turn."""
    logs = log_of_ratio(data.untouched, data.reference)
    held_out = np.concatenate(list(data.held_out.values())) if data.held_out else np.array([], dtype=np.intp)
    apart = np.unique(data.deformation[held_out])
    train = logs[np.unique(data.deformation[data.train])]
    return Bends(train, logs[apart[::2]], logs[apart[1::2]], devices=None if data.drift is None else data.skin)


def solved_bends(data: "TrainingData", train: int = 900) -> Bends:
    """Return a data set's bends and many more, and touches.

    Args:
        data: The data set; its bends kept apart are left to other measurements.
        train: Bends of the wider family to solve for learning; half as many for random devices.
    """
    found = solved(train, APART, data.skin) if data.drift is None else devices(train // 2, APART, data.skin)
    return replace(
        found,
        train=np.concatenate([bends_of(data).train, found.train]),
        touches=small_touches(TOUCHED_BENDS, data.skin, kind=data.touch_kind),
        probes=probes(PROBED_BENDS, PROBE_SEED, data.skin, data.touch_kind),
    )


@lru_cache(maxsize=CACHED_RESULTS)
def solved(train: int, held_out: int, skin: Skin) -> Bends:
    """Return solved bends alone: ``train`` of the wider family, ``held_out`` each of A and B."""
    apart = [untouched_logs(draw(family, held_out, HELD_OUT_SEED, skin), skin) for family in ("A", "B")]
    return Bends(
        untouched_logs(wide_bends(train, TRAIN_SEED, skin), skin),
        np.concatenate([logs[::2] for logs in apart]),
        np.concatenate([logs[1::2] for logs in apart]),
    )


@lru_cache(maxsize=CACHED_RESULTS)
def devices(train: int, held_out: int, skin: Skin) -> Bends:
    """Return untouched moments of random devices alone.

    Args:
        train: Bends of the wider family to learn from, each with many devices.
        held_out: Bends of A, and as many of B, that measure: solved, two of a device. A third as many choose.
        skin: What devices are drawn from.
    """
    apart = [
        (draw("A", held_out, seed, skin), draw("B", held_out, seed, skin)) for seed in (CHOICE_SEED, HELD_OUT_SEED)
    ]
    choose = [bend for family in apart[0] for bend in family[: held_out // 3]]
    return Bends(
        drawn_moments(wide_bends(train, TRAIN_SEED, skin), skin, TRAIN_SEED, LEARNED_DEVICES, MOMENTS_PER_DEVICE),
        drawn_moments(choose, skin, CHOICE_SEED, CHOOSING_DEVICES, MOMENTS_PER_DEVICE),
        np.concatenate([moments(family, skin, HELD_OUT_SEED + n) for n, family in enumerate(apart[1], start=10)]),
        devices=skin,
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
    return log_of_ratio(np.array([voltages(bend) for bend in bends]).reshape(-1, N_ROWS), flat)
