"""The gate of a run: fitted once, kept in the run's folder, and fitted again when it is not of this run.

``gate.npz`` holds the gate's arrays, what was measured of it, the untouched sheets that it was fitted and measured on,
and what it was made of: data set, seed and version. A gate does not depend on the network, so a resumed or adapted run
keeps it.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.arrays import pack_arrays, read_npz
from eitskin_proto.files.reading import FileError, parse_json, read_bytes
from eitskin_proto.files.writing import write_bytes
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER
from eitskin_training.gate import fit, untouched
from eitskin_training.gate.fit import Arrays, Gate
from eitskin_training.gate.untouched import Bends
from eitskin_training.samples.batches import TrainingData

NAME: Final = "gate.npz"

LARGEST_FILE: Final = 256 << 20
"""Bytes of a stored gate with its sheets."""

VERSION: Final = 5
"""Raised whenever a newly fitted gate would differ."""

_GATE, _SHEETS = "gate_", "untouched_"
_STORED_SHEETS: Final = ("train", "choose", "measure")
"""Of the untouched sheets; touches and probes have done their work."""

GiveBends = Callable[[TrainingData], Bends]


@dataclass(frozen=True, slots=True)
class RunGate:
    """A run's gate.

    Args:
        gate: The fitted gate.
        bends: Untouched sheets that it learned from, that chose its threshold and that measured it.
    """

    gate: Gate
    bends: Bends


def made_of(data: TrainingData, seed: int) -> dict[str, Any]:
    """Return what names the gate of a run: one with other values is stale."""
    return {
        "version": VERSION,
        "protocol_id": PROTOCOL_ID,
        "grid_id": data.skin.grid_id,
        "skin_digest": data.skin.digest,
        "data_digest": data.digest,
        "seed": seed,
    }


def gate_of_run(
    folder: Path,
    data: TrainingData,
    seed: int,
    *,
    tell: Callable[[str], None] = lambda _: None,
    bends: GiveBends | None = None,
) -> RunGate:
    """Return a run's gate: the stored one, or one that is fitted now and stored.

    Args:
        folder: The run's.
        data: Its data set.
        seed: Its seed.
        tell: Called with each step, if there is one.
        bends: Gives the untouched sheets; None solves hundreds (:func:`eitskin_training.gate.untouched.solved_bends`).

    Raises:
        SkinError: No bends are held out.
    """
    expected = made_of(data, seed)
    stored = _read(folder / NAME, expected)
    if stored is not None:
        return stored
    tell("gate: solving untouched sheets")
    sheets = (bends or untouched.solved_bends)(data)
    tell("gate: fitting")
    gate = fit.fit(data, sheets, seed=seed)
    found = RunGate(gate, Bends(sheets.train, sheets.choose, sheets.measure))
    try:
        _write(folder / NAME, found, expected)
    except (OSError, FileError) as error:
        tell(f"gate: could not be cached, {error}")
    return found


def hand_on(source: Path, folder: Path) -> None:
    """Give a run that was made from another one that one's gate, if it has any; it is checked when it is read."""
    if (source / NAME).exists():
        folder.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / NAME, read_bytes(source / NAME, LARGEST_FILE))


def _write(path: Path, found: RunGate, origin: dict[str, Any]) -> None:
    arrays: dict[str, npt.NDArray[np.generic]] = {_GATE + name: value for name, value in found.gate.arrays.items()}
    arrays |= {_SHEETS + name: getattr(found.bends, name) for name in _STORED_SHEETS}
    texts = {"made_of": json.dumps(origin), "measures": json.dumps(found.gate.measures)}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, pack_arrays({**arrays, **texts}))


def _read(path: Path, expected: dict[str, Any]) -> RunGate | None:
    """Return a stored gate, or None where there is none, it cannot be read, or it is of another run."""
    try:
        file = read_npz(path, LARGEST_FILE)
        if {"skin_digest": PAPER.digest, **parse_json(str(file["made_of"]))} != expected:
            return None
        arrays: Arrays = {name.removeprefix(_GATE): file[name] for name in file if name.startswith(_GATE)}
        train, choose, measure = (file[_SHEETS + name] for name in _STORED_SHEETS)
        return RunGate(Gate(arrays, parse_json(str(file["measures"]))), Bends(train, choose, measure))
    except (OSError, ValueError, KeyError, TypeError):
        return None
