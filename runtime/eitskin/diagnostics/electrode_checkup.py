"""Checks all sixteen electrodes in a few seconds of frames: state, evidence and advice for each.

Frames are compared with a captured reference if there is one, else with the forward model's flat sheet, scaled to the
device's current. The model also finds an electrode that failed before any reference was captured; it allows a real
sheet to be a few percent off in every row. If a device scans all 208 rows, each row and its reciprocal must agree; no
touch and no deformation breaks that.

No electrode can be judged where rows are in another order than the device states. Levels show that
(:mod:`eitskin_proto.sensor.wiring`), once two wires that the watch found exchanged are exchanged back.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.acquisition.capture import whole_frames
from eitskin.acquisition.device import Device
from eitskin.acquisition.ports import open_line
from eitskin.acquisition.serial_port import DEFAULT_BAUD
from eitskin.errors import BadReference
from eitskin.health.electrodes import NOT_RECIPROCAL, WELL, WINDOW, ElectrodeWatch
from eitskin.health.imputation import Array, Consistency
from eitskin.health.reciprocity import LARGEST_RECORDED_GAP, electrode_gaps, row_gaps
from eitskin.reference.captured import Reference
from eitskin.reference.front_end import front_end_faults
from eitskin.reference.normaliser import normaliser_of
from eitskin_proto.files.arrays import read_npy
from eitskin_proto.files.reading import FileError
from eitskin_proto.sensor.noise_law import noise_law
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.table import N_ELECTRODES, N_FULL_ROWS, N_ROWS
from eitskin_proto.sensor.wiring import read_wiring
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.volts import step_of

MODEL_SPREAD: Final = 0.02
"""Relative difference that a real sheet may have from the forward model in a row, when the model replaces a
reference."""

UNKNOWN: Final = "unknown"
"""State of every electrode while the front end hangs, or rows are in a wrong order."""

LARGEST_RECORDING: Final = 256 << 20
"""Bytes of a recording: 27 minutes at 200 frames/s."""

ADVICE: Final[dict[str, str]] = {
    WELL: "nothing to do",
    "detached": "check its wire and its contact: wet or replace the hydrogel, press the contact on, solder the wire",
    "shorted": "look for a bridge between the two: water, hydrogel, solder, a pinched cable",
    "swapped": "exchange the two wires at the plug; until then the runtime swaps their rows back",
    "noisy": "its contact comes and goes: fix the wire so that it does not move, renew the hydrogel",
    "excluded": "you excluded it",
    UNKNOWN: "fix the front end or the order of rows first",
    NOT_RECIPROCAL: "it measures differently than it drives: check its wire, its contact and the front end's switch",
}
"""Advice for each state."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Some seconds of frames."""

    voltages: Array
    """(n, 104) V."""
    gap: Array | None
    """(104,) median relative difference of each row and its reciprocal; None where 104 rows are scanned."""
    step_V: float | None = None
    """Of one count; None if the file does not state it."""


def record(port: str, seconds: float, baud: int = DEFAULT_BAUD) -> Recording:
    """Return a skin's frames of some seconds.

    Args:
        port: Serial port's path, or ``usb:SERIAL``.
        seconds: How long.
        baud: Bits per second on a real UART.

    Raises:
        TransportError: The port is missing, busy, denied or lost.
        HandshakeError: The device does not answer, or measures in a way that cannot be used.
        BadReference: Too few frames came to detect failures.
        ValueError: The time is not positive.
    """
    if not 0 < seconds < 3600:
        raise ValueError(f"seconds is {seconds}, expected more than 0 and less than 3600")
    transport = open_line(port, baud)
    try:
        device = Device(transport)
        device.start()
        normaliser = normaliser_of(device.hello)
        volts, gaps = [], []
        for view in whole_frames(device, time.perf_counter() + seconds):
            normaliser.load(view.counts)
            volts.append(normaliser.voltages().copy())
            if isinstance(view, FrameView) and (gap := _gap(view.counts)) is not None:
                gaps.append(gap)
        device.stop()
    finally:
        transport.close()
    if len(volts) < WINDOW:
        raise BadReference(
            f"found {len(volts)} whole frames in {seconds:g} s, expected at least {WINDOW}: raise --seconds, or check "
            "the cable"
        )
    return Recording(np.array(volts), np.median(gaps, axis=0) if gaps else None, step_of(device.hello))


def _gap(counts: npt.NDArray[np.int32]) -> Array | None:
    """Return (104,) relative differences of rows and their reciprocals, of a frame of 208 rows."""
    if len(counts) != N_FULL_ROWS:
        return None
    apart, size = row_gaps(counts)
    return np.asarray(np.abs(apart) / np.maximum(size, 1.0))


def load_recording(path: str | Path) -> Recording:
    """Return a recorded stream: an .npy file of (n, 104) V.

    Raises:
        BadReference: It cannot be read, or is of another shape.
    """
    try:
        found = read_npy(path, LARGEST_RECORDING)
    except (OSError, FileError) as error:
        raise BadReference(f"{path} cannot be read as .npy: {error}") from error
    if found.ndim != 2 or found.shape[1] != N_ROWS or len(found) < WINDOW:
        raise BadReference(f"{path}: found {found.shape}, expected at least ({WINDOW}, {N_ROWS}) V")
    if found.dtype.kind != "f" or not np.isfinite(found).all():
        raise BadReference(f"{path}: expected finite numbers in V")
    return Recording(found.astype(np.float64), None)


def check_up(recording: Recording, consistency: Consistency, reference: Reference | None = None) -> dict[str, Any]:
    """Return all sixteen electrodes as plain values.

    Args:
        recording: Frames of a sheet in any shape, touched or not.
        consistency: Of a bundle.
        reference: What the frames are compared with; None takes the forward model's flat sheet.
    """
    volts, spread = _against(recording, consistency, reference)
    watch = ElectrodeWatch(consistency, volts, spread)
    seen: list[Sequence[npt.NDArray[np.float64]]] = []
    corrected: list[npt.NDArray[np.float32]] = []
    for voltages in recording.voltages:
        raw = relative_change(voltages, volts).astype(np.float32)
        change = raw.copy()
        watch.correct(change)
        watch.update(raw, change)
        corrected.append(change)
        evidence = watch.evidence
        seen.append((evidence.surprise, evidence.pair_ratio, evidence.jumping))
    surprise, ratio, jumping = (np.median([one[part] for one in seen], axis=0) for part in range(3))
    gaps = None if recording.gap is None else electrode_gaps(recording.gap)
    faults = front_end_faults(recording.voltages, recording.step_V)
    exchanged = volts * (1.0 + np.median(corrected, axis=0))
    wirings = [read_wiring(read, consistency.reference) for read in (recording.voltages, exchanged)]
    wiring = next((one for one in wirings if one.right), wirings[0])
    wrong = not (wiring.right or faults)
    found = []
    for electrode, watched in enumerate(watch.states()):
        gap = None if gaps is None else float(gaps[electrode])
        apart = watched == WELL and gap is not None and gap > LARGEST_RECORDED_GAP
        state = UNKNOWN if faults or wrong else NOT_RECIPROCAL if apart else watched
        partner = next((f.partner for f in watch.findings if f.electrode == electrode), None)
        found.append(
            {"electrode": electrode, "state": state, "partner": partner,
             "surprise": round(float(surprise[electrode]), 2), "pair_ratio": round(float(ratio[electrode]), 4),
             "jumping": round(float(jumping[electrode]), 3), "reciprocity_gap": None if gap is None else round(gap, 4),
             "to_do": ADVICE[state]}
        )  # fmt: skip
    return {
        "frames": len(recording.voltages),
        "against": "forward model" if reference is None else f"reference of {reference.captured_utc}",
        "surprise_limit": round(watch.threshold, 1),
        "unclear": watch.unclear,
        "front_end": list(faults),
        "wiring": {"right": not wrong, "text": wiring.text, "rank_correlation": round(wiring.rank_correlation, 3)},
        "electrodes": found,
        "noise": None if faults else _noise(recording.voltages),
    }


def _noise(voltages: Array) -> list[str] | None:
    """Return the noise law in lines; None where rows do not vary."""
    try:
        return noise_law(voltages).lines()
    except ValueError:
        return None


def _against(recording: Recording, consistency: Consistency, reference: Reference | None) -> tuple[Array, Array]:
    """Return (104,) V and its spread that frames are compared with."""
    if reference is not None:
        flat = reference.flat()
        return flat.voltages_V, flat.spread_V
    model = consistency.reference
    middle = np.median(recording.voltages, axis=0)
    factor = float(np.median(middle / model))  # of the current: half of the rows suffice, the failed ones are fewer
    return model * factor, np.abs(model * factor) * MODEL_SPREAD


def lines(found: dict[str, Any]) -> list[str]:
    """Return the text of :func:`check_up` for people: the verdict, then a line for each electrode."""
    shown = [_verdict(found), f"{found['frames']} frames, compared with the {found['against']}"]
    for one in found["electrodes"]:
        partner = "" if one["partner"] is None else f" with {one['partner']}"
        gap = "" if one["reciprocity_gap"] is None else f"  reciprocity {one['reciprocity_gap']:.2%}"
        shown.append(
            f"electrode {one['electrode']:2d}  {_in_words(one['state'])}{partner}  "
            f"rows deviate by {one['surprise'] / found['surprise_limit']:.0%} of the limit  "
            f"pair at {one['pair_ratio']:.0%}  jumps {one['jumping']:.0%}{gap}  "
            f"{one['to_do']}"
        )
    shown += [f"front end: {fault}" for fault in found["front_end"]]
    if found["wiring"]["right"] and not found["front_end"]:
        shown.append(f"wiring: {found['wiring']['text']}")
    shown += found["noise"] or []
    return shown


def _verdict(found: dict[str, Any]) -> str:
    """Return which electrodes need work, in a sentence."""
    if found["front_end"]:
        return "The front end fails, so no electrode can be judged: power the device off and on, check supply and plug."
    if not found["wiring"]["right"]:
        return f"No electrode can be judged: {found['wiring']['text']}."
    if found["unclear"]:
        return "The rows fit neither a sheet nor any single failure: check the plug, then every wire."
    bad = [f"{one['electrode']} {one['state']}" for one in found["electrodes"] if one["state"] != WELL]
    if not bad:
        return f"All {N_ELECTRODES} electrodes work."
    return f"{len(bad)} of {N_ELECTRODES} electrodes {'needs' if len(bad) == 1 else 'need'} work: {', '.join(bad)}."


def _in_words(state: str) -> str:
    return "works" if state == WELL else state
