"""The readings with a failed electrode: a circuit around the sheet, exact for any touch and deformation.

The sheet is its 16 x 16 response R, volts at each electrode per ampere into each. Wires lead from the front end to the
electrodes, and a fault is a change of that circuit ::

    detached   a series resistance r: the current source ends at its compliance, the input pulls a floating wire to zero
    shorted    a resistance between two wires:     Z <- Z - Z s s^T Z / (s^T Z s + r_short),   s = e_a - e_b
    swapped    two wires exchanged
    noisy      a contact that comes and goes: its readings jump, and so does the current that it carries

With an ideal source and an ideal voltmeter a series resistance changes nothing, since every row is a four-point
measurement: a contact impedance that doubles is no fault. It takes a finite compliance, and a finite input impedance,
to see a wire that came off.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import FULL_TABLE, N_ELECTRODES
from eitskin_sim.arrays import Array
from eitskin_sim.fem.forward import Factor

COMPLIANCE_OHM: Final = 3300.0
"""The load up to which the source holds its current: 3.3 V at 1 mA."""

INPUT_OHM: Final = 1e6
"""A wire's load to mid potential: 8 pF at 20 kHz."""

SHORT_OHM: Final = 0.1
"""What joins two shorted wires."""

CONTACT_OHM: Final = 6.25
"""A healthy contact: 1e-4 ohm m^2 over 4 x 4 mm."""


@dataclass(frozen=True, slots=True)
class Detached:
    """An electrode whose contact impedance grew by a factor."""

    electrode: int
    factor: float = 1e5


@dataclass(frozen=True, slots=True)
class Shorted:
    """Two electrodes whose wires touch."""

    first: int
    second: int


@dataclass(frozen=True, slots=True)
class Swapped:
    """Two electrodes whose wires were exchanged."""

    first: int
    second: int


@dataclass(frozen=True, slots=True)
class Noisy:
    """An electrode whose contact comes and goes."""

    electrode: int
    level: float = 0.03
    """Of the root mean square over all rows, on what it measures; of the current, on what it drives."""


Fault = Detached | Shorted | Swapped | Noisy


def response_of(factor: Factor) -> Array:
    """Return the (16, 16) ohm of a solved sheet, electrode 15 being the way out of every current."""
    potentials = factor.polished()
    found = np.zeros((N_ELECTRODES, N_ELECTRODES))
    for electrode in range(N_ELECTRODES - 1):
        found[:, electrode] = potentials[electrode : N_ELECTRODES - 1].sum(axis=0)
    return found


def measure(
    response: Array,
    faults: Sequence[Fault] = (),
    *,
    table: npt.NDArray[np.uint8] = FULL_TABLE,
    rng: np.random.Generator | None = None,
) -> Array:
    """Return the (rows,) V that a front end of 1 A reads.

    Args:
        response: (16, 16) ohm of the sheet.
        faults: What is wrong; several at once are allowed.
        table: (rows, 2) drive and measure of each row.
        rng: Draws the noise of noisy electrodes; a frame a call.

    Raises:
        ValueError: An electrode does not exist, a fault names one twice, or there is noise but nothing to draw it from.
    """
    _check(faults, rng)
    wires, series = _circuit(response, faults)
    leak = 1.0 / (1.0 + series / INPUT_OHM)
    drive, sense = table[:, 0].astype(np.intp), table[:, 1].astype(np.intp)
    after = (np.arange(N_ELECTRODES) + 1) % N_ELECTRODES
    loads = np.diag(wires) + np.diag(wires)[after] - wires[np.arange(16), after] - wires[after, np.arange(16)]
    current = np.minimum(1.0, COMPLIANCE_OHM / np.maximum(np.abs(loads), 1e-12))
    potentials = current[:, None] * (wires - np.roll(wires, -1, axis=1)).T  # (16 drives, 16 wires)
    potentials = leak * (potentials - potentials.mean(axis=1, keepdims=True))
    rows = potentials[drive, sense] - potentials[drive, after[sense]]
    for fault in faults:
        if isinstance(fault, Noisy) and rng is not None:
            _disturb(rows, fault, drive, sense, rng)
    return np.asarray(rows)


def _check(faults: Sequence[Fault], rng: np.random.Generator | None) -> None:
    for fault in faults:
        named = (fault.electrode,) if isinstance(fault, Detached | Noisy) else (fault.first, fault.second)
        if not all(0 <= electrode < N_ELECTRODES for electrode in named) or len(set(named)) != len(named):
            raise ValueError(f"{fault} names electrodes {named}; expected different ones from 0 to {N_ELECTRODES - 1}")
        if isinstance(fault, Noisy) and rng is None:
            raise ValueError(f"{fault} needs rng to draw its noise from")


def _circuit(response: Array, faults: Sequence[Fault]) -> tuple[Array, Array]:
    """Return the (16, 16) ohm seen from the wires, and each wire's (16,) series resistance in ohm."""
    series, order = np.zeros(N_ELECTRODES), np.arange(N_ELECTRODES)
    for fault in faults:
        if isinstance(fault, Detached):
            series[fault.electrode] += (fault.factor - 1.0) * CONTACT_OHM
        elif isinstance(fault, Swapped):
            order[[fault.first, fault.second]] = order[[fault.second, fault.first]]
    wires = response[np.ix_(order, order)] + np.diag(series[order])
    for fault in faults:
        if isinstance(fault, Shorted):
            across = wires[:, fault.first] - wires[:, fault.second]
            back = wires[fault.first] - wires[fault.second]
            load = across[fault.first] - across[fault.second] + SHORT_OHM
            wires = wires - np.outer(across, back) / load
    return wires, series[order]


def _disturb(
    rows: Array,
    fault: Noisy,
    drive: npt.NDArray[np.intp],
    sense: npt.NDArray[np.intp],
    rng: np.random.Generator,
) -> None:
    size = fault.level * float(np.sqrt(np.mean(np.square(rows))))
    before = (fault.electrode - 1) % N_ELECTRODES
    senses, drives = np.isin(sense, (before, fault.electrode)), np.isin(drive, (before, fault.electrode))
    rows += senses * size * rng.standard_normal(len(rows))
    rows *= 1.0 + drives * fault.level * rng.standard_normal(len(rows))
