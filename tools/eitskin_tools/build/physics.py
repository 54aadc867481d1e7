"""A bundle from the forward model alone, in a minute and without torch: for a new sheet that no network knows.

::

    skin -> flat sheet: Jacobian, V0 --+--> l1.npz, tikhonov.npy
         -> untouched sheets, bent ----+--> gate.npz

Untouched sheets are random devices of the skin where it is a rectangle, and the stated device where it is a disc.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.arrays import pack_arrays
from eitskin_proto.skin.skin import Skin
from eitskin_tools.build.steps import Tell, samples_said

Array = npt.NDArray[np.float64]

BENDS: Final = {"learn": 80, "choose": 60, "measure": 30}
"""Untouched sheets by their use."""

TOGETHER: Final = 10
"""Bends that a process solves at a time."""

DEVICES: Final = 4
MOMENTS: Final = 4
"""Random devices of each bend, and moments of each."""

SEED: Final = 0x9B15


@dataclass(frozen=True, slots=True)
class FlatSheet:
    """The flat, untouched sheet that a skin states.

    Args:
        voltages_V: (104,) under 1 A.
        jacobian: (104, pixels) relative change of each row with that of each pixel's conductivity; 0 off the sheet.
        inside: (pixels,) which are on the sheet.
    """

    voltages_V: Array
    jacobian: Array
    inside: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, skin: Skin) -> "FlatSheet":
        """Return that of a skin, a rectangle or a disc."""
        from eitskin_sim.fem.jacobian import flat_jacobian
        from eitskin_sim.surface.predict import flat_voltages
        from eitskin_sim.tank.round_sheet import RoundSheet

        if skin.outline.kind == "disc":
            sheet = RoundSheet(skin)
            return cls(sheet.voltages(), sheet.relative_jacobian(), sheet.inside)
        return cls(flat_voltages(skin), flat_jacobian(skin), np.ones(skin.grid.n_pixels, dtype=np.bool_))


def build(
    skin: Skin,
    out: Path,
    workers: int,
    tell: Tell = lambda _: None,
    say: Tell = lambda _: None,
    bends: Mapping[str, int] = BENDS,
) -> dict[str, Any]:
    """Write the bundle of a skin and return what ``eitskin build --json`` prints.

    Args:
        skin: What it is for.
        out: The bundle's path.
        workers: Processes.
        tell: Called with each step.
        say: Called every few seconds with how many sheets are solved.
        bends: Untouched sheets that are solved for each use.
    """
    from eitskin.model.bundle import L1_FILE
    from eitskin_export.bundle import amend, projection_bytes, write
    from eitskin_sim.measurement.noise import spread_of
    from eitskin_sim.solvers.whitened import l1_arrays, tikhonov_of_logs, whitening_of
    from eitskin_tools.evaluation import physics_card
    from eitskin_training.gate.physical import physical_gate, touch_logs

    began, rng = time.monotonic(), np.random.default_rng(SEED)
    tell("solving the flat sheet")
    flat = FlatSheet.of(skin)
    tell("solving untouched sheets at bends")
    untouched = untouched_of(skin, workers, bends, samples_said(say, "sheets"))
    tell("fitting solvers and gate")
    noise = spread_of(flat.voltages_V, skin.front_end.noise, float(np.mean(skin.front_end.snr_db)))
    whitening = whitening_of(untouched.learn, noise / np.abs(flat.voltages_V))
    touches, sizes_mm = touch_logs(flat.jacobian, skin, flat.inside, rng)
    gate, measures = physical_gate(untouched, touches, sizes_mm, flat.voltages_V, skin, rng)
    projection = tikhonov_of_logs(whitening, flat.jacobian, skin.touch_kind)
    files = {
        L1_FILE: pack_arrays(l1_arrays(whitening, flat.jacobian, skin.touch_kind)),
        "tikhonov.npy": projection_bytes(projection, skin.grid),
        "gate.npz": pack_arrays(gate),
    }
    facts = {
        "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "labels": "area",
        "touches": skin.touch_kind,
        "gate": measures,
        "physics": {"bends": dict(bends)},
        "metrics": {},
    }
    write(out, files, facts, skin)
    tell("testing for the card")
    card = {**physics_card.card_of(out), "build_s": round(time.monotonic() - began, 1)}
    identity = amend(out, {"card": card})
    return {
        "bundle": identity,
        "path": str(out),
        "bytes": out.stat().st_size,
        "labels": "area",
        "touches": skin.touch_kind,
        "seconds": round(time.monotonic() - began, 1),
        "gate": measures,
        "card": card,
    }


def untouched_of(
    skin: Skin, workers: int, bends: Mapping[str, int], progress: Callable[[int, int], None] = lambda *_: None
) -> Any:
    """Return the untouched sheets (:class:`eitskin_training.gate.physical.Untouched`) of a skin."""
    from eitskin_sim.dataset.generate import processes
    from eitskin_training.gate.physical import Untouched

    jobs = [
        (use, first, min(first + TOGETHER, count))
        for use, count in bends.items()
        for first in range(0, count, TOGETHER)
    ]
    found: dict[str, list[Array]] = {use: [] for use in bends}
    done = 0
    with processes(workers) as pool:
        made = pool.map(_untouched_logs, [skin] * len(jobs), *zip(*jobs, strict=True))
        for (use, first, stop), part in zip(jobs, made, strict=True):
            found[use].append(part)
            done += stop - first
            progress(done, sum(bends.values()))
    return Untouched(**{use: np.concatenate(one) for use, one in found.items()})


def _untouched_logs(skin: Skin, use: str, first: int, stop: int) -> Array:
    """Return (n, 104) log(V / V0) of untouched sheets at some of the bends of a use."""
    from eitskin_proto.sensor.row_gaussian import log_of_ratio
    from eitskin_sim.tank.round_sheet import RoundSheet
    from eitskin_training.gate.moments import drawn_moments

    is_round = skin.outline.kind == "disc"
    sheet = RoundSheet(skin)
    bends = _bends(sheet.square if is_round else skin, use, stop)[first:]
    if is_round:
        return log_of_ratio(np.array([sheet.voltages(bend) for bend in bends]), sheet.voltages())
    return drawn_moments(bends, skin, SEED + first, DEVICES * len(bends), MOMENTS)


def _bends(skin: Skin, use: str, count: int) -> list[Any]:
    """Return the first bends of a use: wide ones to learn from, else of the families A and B by turns."""
    from eitskin_sim.scene.family import draw
    from eitskin_training.gate.touches import wide_bends
    from eitskin_training.gate.untouched import CHOICE_SEED, HELD_OUT_SEED, TRAIN_SEED

    if use == "learn":
        return wide_bends(count, TRAIN_SEED, skin)
    seed = CHOICE_SEED if use == "choose" else HELD_OUT_SEED
    families = [draw(family, (count + 1) // 2, seed, skin) for family in ("A", "B")]
    return [bend for both in zip(*families, strict=True) for bend in both][:count]
