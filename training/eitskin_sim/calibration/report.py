"""The result of a calibration as numbers: each parameter with its error, each row with its residual."""

from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.stats import chi2

from eitskin_proto.sensor.table import N_ROWS, TABLE
from eitskin_proto.skin.skin import Skin
from eitskin_sim.calibration.fit import MISFIT_LEVEL, NAMED_ROW_SD, CalibrationError, Fit, fit
from eitskin_sim.calibration.line import straight_line
from eitskin_sim.calibration.model import Model
from eitskin_sim.calibration.parameters import COMMON_OFFSET
from eitskin_sim.calibration.recording import LaterReading, Recording
from eitskin_sim.calibration.session import Progress, Session, check_felt
from eitskin_sim.calibration.stamp import BORDER, GROWTH, PLACE, PRESS_CONTRAST, STRENGTH, WAYS
from eitskin_sim.calibration.twin import MAX_LEARNED_SD_RATIO, calibrated_skin
from eitskin_sim.calibration.unseen import UNSEEN

MOMENT_ERRORS: Final = (0.01, 0.0)
"""Relative errors that are added to the rows of moments, one after the other, once the reference is fitted."""

LEVEL_PRIOR_FACTOR: Final = 5.0
"""The level's prior reaches so far."""

MAX_NAMED_ROWS: Final = 6
"""Rows that a message names."""

MOMENT_ROWS: Final = [f"drive {drive} measure {measure}" for drive, measure in TABLE]
"""A name for every row of a bent moment or a press."""


def calibrate(
    skin: Skin, recording: Recording, snr_db: float | None = None, progress: Progress | None = None
) -> tuple[Skin, dict[str, Any]]:
    """Return the calibrated skin, and the object that ``eitskin calibrate --json`` prints.

    Args:
        skin: The stated one.
        recording: What was read.
        snr_db: Of a single frame; None takes the least that the skin states.
        progress: Called with the step's number and the misfit.

    The most probable sheet is returned whether or not it explains the readings; where it does not, its errors are
    enlarged by the misfit, and the report names the rows.

    Raises:
        CalibrationError: The skin states every value as exact, or presses change nothing.
    """
    recording, current_A = per_ampere(skin, recording)
    model = Model(skin, recording, snr_db)
    if len(model.parameters.groups) == 1 and not recording.presses:
        raise CalibrationError(
            f"skin {skin.name} gives every value as exact, so there is nothing to calibrate: write uncertainties into "
            f"its file, as {{value = .., normal = ..}}, or name another skin, such as --skin "
            "lab"
        )
    found = fit(model, progress)
    session = Session(skin, recording, snr_db)
    if recording.bents or recording.presses:
        session, found = _with_moments(session, found, progress)
    unexplained = misfits(session, found)
    if unexplained:
        worst = max(one["misfit"] for one in unexplained)
        found = replace(found, sd=np.minimum(found.sd * np.sqrt(max(worst, 1.0)), 1.0))
    twin = calibrated_skin(skin, session, found)
    return twin, {
        **fields(session, found, twin),
        "explained": not unexplained,
        "unexplained": unexplained,
        "current_A": current_A,
    }


def per_ampere(skin: Skin, recording: Recording) -> tuple[Recording, float]:
    """Return a recording scaled to 1 A with the offset of its straight line, and its current as far as it is known.

    Only the contacts distinguish the layer's conductivity from the current, so voltages that are within
    ``LEVEL_PRIOR_FACTOR`` of the stated skin's under 1 A are left as they are: the level finds it. A current below 0 is
    one whose voltages have the sign that other programs give a pair.
    """
    model = Model(skin, recording)
    line = straight_line(recording.reference_V, model.read(np.zeros(model.count), derivatives=False).voltages_V)
    current_A = abs(line.factor)
    if 1.0 / LEVEL_PRIOR_FACTOR < current_A < LEVEL_PRIOR_FACTOR:
        current_A = 1.0
    current_A *= float(np.sign(line.factor))

    def scaled(moments: tuple[LaterReading, ...]) -> tuple[LaterReading, ...]:
        return tuple(replace(one, voltages_V=one.voltages_V / current_A) for one in moments)

    volts, bents, presses = recording.reference_V / current_A, scaled(recording.bents), scaled(recording.presses)
    offset = line.offset_V / current_A
    return replace(recording, reference_V=volts, bents=bents, presses=presses, offset_V=offset), current_A


def _with_moments(session: Session, flat: Fit, progress: Progress | None) -> tuple[Session, Fit]:
    """Return the fit of the whole recording, from that of its reference; presses go the way that fits."""
    skin, recording, level = session.flat.skin, session.flat.recording, session.flat.snr_db
    tried = [Session(skin, recording, level, way) for way in WAYS] if recording.presses else [session]
    start = np.concatenate([flat.z, np.zeros(tried[0].count - len(flat.z))])

    def off(one: Session) -> float:
        one.soften(start, MOMENT_ERRORS[0])
        return float(np.sum(one.residuals(start) ** 2))

    chosen = tried[0] if len(tried) == 1 else min(tried, key=off)
    if recording.presses:
        check_felt(chosen)
    return chosen, fit(chosen, progress, start=start, soft=MOMENT_ERRORS, done=flat.steps, rough=True)


def misfits(session: Session, found: Fit) -> list[dict[str, Any]]:
    """Return what the sheet does not explain: of the reference and each moment its misfit, limit and worst rows."""
    model, block = session.flat, session.blocks[0]
    residuals = found.residuals[block]
    misfit = float((residuals @ residuals + found.z @ found.z) / len(residuals))
    limit = float(chi2.isf(MISFIT_LEVEL, len(residuals))) / len(residuals)
    if model.unseen is not None:
        limit += (model.unseen.largest - 1.0) * N_ROWS / len(residuals)
    every = [("reference", misfit, limit, _worst(found.far[block], row_names(model)))]
    own, rows = session.flat.parameters.slices, len(TABLE)
    chance = float(chi2.isf(MISFIT_LEVEL / max(len(session.moments), 1), rows)) / rows
    for number, (moment, block) in enumerate(zip(session.moments, session.blocks[1:], strict=True)):
        size = float(np.sum(found.residuals[block] ** 2))
        if moment.lying.touched_by:
            press = number - len(session.flat.recording.bents)
            place = own[PLACE].start + 2 * press
            size += float(found.z[own[PRESS_CONTRAST].start + press] ** 2 + np.sum(found.z[place : place + 2] ** 2))
        every.append((moment.name, size / rows, chance * moment.allowed, _worst(found.far[block], MOMENT_ROWS)))
    return [
        {"name": name, "misfit": misfit, "limit": limit, "rows": worst}
        for name, misfit, limit, worst in every
        if not misfit <= limit
    ]


def _worst(far: Any, rows: list[str]) -> str:
    return ", ".join(f"{rows[at]} by {abs(far[at]):.1f}" for at in np.argsort(-np.abs(far))[:MAX_NAMED_ROWS])


def row_names(model: Model) -> list[str]:
    """Return a name for every residual of the reference."""
    return [f"drive {drive} measure {measure}" for drive, measure in model.table]


def fields(session: Session, found: Fit, twin: Skin) -> dict[str, Any]:
    """Return the object for JSON."""
    model, block = session.flat, session.blocks[0]
    parameters = {}
    for name, group in model.parameters.groups.items():
        if name == UNSEEN:
            continue
        z, sd = (one[model.parameters.slices[name]] for one in (found.z, found.sd))
        values, errors = group.values(z), group.errors(z, sd)
        parameters[name] = {
            "unit": group.unit,
            "values": values.tolist(),
            "standard_errors": errors.tolist(),
            "prior_errors": group.errors(z, np.ones(len(z))).tolist(),
            "unknown": bool((sd > MAX_LEARNED_SD_RATIO).all()),
            "unknown_ones": np.flatnonzero(sd > MAX_LEARNED_SD_RATIO).tolist(),
        }
    rows = row_names(model)
    moments = {}
    n_bents = len(session.flat.recording.bents)
    for number, (moment, own) in enumerate(zip(session.moments, session.blocks[1:], strict=True)):
        far = found.far[own]
        named = [f"drive {drive} measure {measure}" for drive, measure in TABLE]
        moments[moment.name] = {
            "misfit": float(np.mean(found.residuals[own] ** 2)),
            "residuals": dict(zip(named, far.tolist(), strict=True)),
            "far": [row for row, one in zip(named, far, strict=True) if abs(one) > NAMED_ROW_SD],
            "press": own_fields(session, found, number - n_bents) if moment.lying.touched_by else None,
        }
    return {
        "skin_digest": twin.digest,
        "calibrated_from": twin.calibrated_from,
        "steps": found.steps,
        "settled": found.settled,
        "misfit": found.misfit,
        "misfit_limit": found.limit,
        "parameters": parameters,
        "reference_scan": scan_fields(model, found),
        "residuals": dict(zip(rows, found.far[block].tolist(), strict=True)),
        "far": [row for row, far in zip(rows, found.far[block], strict=True) if abs(far) > NAMED_ROW_SD],
        "offset_V": offset_field(model, found),
        "stated_kind": model.skin.touches.kind,
        "moments": moments,
        "press": press_fields(session, found),
        "unknown": [_unknown(name, one) for name, one in parameters.items() if one["unknown_ones"]],
    }


def _unknown(name: str, parameter: dict[str, Any]) -> str:
    """Return a group's name where all of it is unknown, and with the numbers of those that are where some are."""
    ones = parameter["unknown_ones"]
    firsts = [one for one in ones if one - 1 not in ones]
    lasts = [one for one in ones if one + 1 not in ones]
    runs = [f"{one}" if one == last else f"{one}-{last}" for one, last in zip(firsts, lasts, strict=True)]
    return name if parameter["unknown"] else f"{name}[{', '.join(runs)}]"


def own_fields(session: Session, found: Fit, number: int) -> dict[str, Any]:
    """Return how much stronger a press was than the others, as a factor of log contrast, and how far off its place."""
    groups, own = session.flat.parameters.groups, session.flat.parameters.slices
    strength, at = (
        slice(own[PRESS_CONTRAST].start + number, own[PRESS_CONTRAST].start + number + 1),
        own[PLACE].start + 2 * number,
    )
    factor = float(np.exp(groups[PRESS_CONTRAST].spread * found.z[strength][0]))
    return {
        "strength": factor,
        "strength_error": factor * groups[PRESS_CONTRAST].spread * float(found.sd[strength][0]),
        "off_mm": (groups[PLACE].spread * found.z[at : at + 2]).tolist(),
        "off_error_mm": (groups[PLACE].spread * found.sd[at : at + 2]).tolist(),
    }


def offset_field(model: Model, found: Fit) -> dict[str, float]:
    """Return the mean offset of all pairs and its standard error, V under 1 A."""
    parameters, each = model.parameters, np.zeros(model.count)
    for name in (COMMON_OFFSET, "offset_V"):
        if name in parameters.groups:
            own = parameters.slices[name]
            each[own] = parameters.groups[name].errors(found.z[own], found.sd[own]) / (own.stop - own.start)
    value = parameters.values("offset_V", found.z).mean() + parameters.one(COMMON_OFFSET, found.z)
    return {"value": float(value), "error": float(np.linalg.norm(each))}


def scan_fields(model: Model, found: Fit) -> dict[str, float] | None:
    """Return the unseen error of the reference's scan, rms of logarithms; None if the sheet was flat."""
    if model.unseen is None:
        return None
    return {
        "unseen_rms": float(np.sqrt(np.mean(model.unseen_log(found.z) ** 2))),
        "expected_rms": model.unseen.expected_rms,
    }


def press_fields(session: Session, found: Fit) -> dict[str, Any] | None:
    """Return the parameters of a press of the stamp, with standard errors; None without presses."""
    if not session.flat.recording.presses:
        return None
    stamp_mm = session.flat.recording.presses[0].stamp_mm
    assert stamp_mm is not None
    parameters = session.flat.parameters
    strength, growth, border = (parameters.one(name, found.z) for name in (STRENGTH, GROWTH, BORDER))
    errors = [
        float(parameters.groups[name].errors(found.z[own], found.sd[own])[0])
        for name in (STRENGTH, GROWTH, BORDER)
        for own in [parameters.slices[name]]
    ]
    contrast = float(np.exp(session.way * strength))
    return {
        "stamp_mm": list(stamp_mm),
        "contrast": contrast,
        "contrast_error": contrast * errors[0],
        "size_mm": [one + growth for one in stamp_mm],
        "size_error_mm": errors[1],
        "border_mm": border,
        "border_error_mm": errors[2],
    }
