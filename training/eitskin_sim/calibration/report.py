"""What calibration found, as numbers and as a table: each parameter with its error, each row with its residual."""

from typing import Any, Final

import numpy as np

from eitskin_proto.skin.skin import Skin
from eitskin_sim.calibration.fit import FAR, CalibrationError, Fit, fit
from eitskin_sim.calibration.model import Model
from eitskin_sim.calibration.parameters import OWN_LAYER
from eitskin_sim.calibration.recording import Recording
from eitskin_sim.calibration.twin import UNKNOWN, calibrated_skin

MOST_NAMED: Final = 6
"""Rows that a message names."""


def calibrate(
    skin: Skin, recording: Recording, snr_db: float | None = None, progress: Any = None
) -> tuple[Skin, dict[str, Any]]:
    """Return the calibrated skin, and the object that ``eitskin calibrate --json`` prints.

    Args:
        skin: The stated one.
        recording: What was read.
        snr_db: Of a single frame; None takes the least that the skin states.
        progress: Called with the step's number and the misfit.

    Raises:
        CalibrationError: It does not converge, or its residual stays above noise.
    """
    model = Model(skin, recording, snr_db)
    if len(model.parameters.groups) == 1:
        raise CalibrationError(
            f"skin {skin.name} states everything exactly: there is nothing to calibrate; say in its file how sure you "
            "are, as {value = .., normal = ..}, or name one that does, as --skin lab"
        )
    found = fit(model, progress)
    check_rows(model, found)
    twin = calibrated_skin(skin, model, found)
    return twin, fields(model, found, twin)


def check_rows(model: Model, found: Fit) -> None:
    """Refuse a fit whose residual stays above noise.

    Raises:
        CalibrationError: With the rows.
    """
    if found.misfit <= found.limit:
        return
    worst = np.argsort(-np.abs(found.far))[:MOST_NAMED]
    rows = row_names(model)
    named = ", ".join(f"{rows[at]} by {abs(found.far[at]):.1f}" for at in worst)
    raise CalibrationError(
        f"the residual stays above noise: misfit {found.misfit:.3g}, expected at most {found.limit:.3g}; rows that are "
        f"off by so many times their noise: {named}; look at these electrodes ('eitskin doctor --electrodes'), at the "
        "noise ([front_end] snr_db, --snr-db), and at the uncertainties that the skin states"
    )


def row_names(model: Model) -> list[str]:
    """Return a name for every residual."""
    return [f"drive {drive} measure {measure}" for drive, measure in model.table]


def fields(model: Model, found: Fit, twin: Skin) -> dict[str, Any]:
    """Return what is printed as JSON."""
    parameters = {}
    for name, group in model.parameters.groups.items():
        z, sd = (one[model.parameters.slices[name]] for one in (found.z, found.sd))
        values, errors = group.values(z), group.errors(z, sd)
        parameters[name] = {
            "unit": group.unit,
            "values": values.tolist(),
            "standard_errors": errors.tolist(),
            "prior_errors": group.errors(z, np.ones(len(z))).tolist(),
            "unknown": bool(np.median(sd) > UNKNOWN),
        }
    rows = row_names(model)
    return {
        "skin_digest": twin.digest,
        "calibrated_from": twin.calibrated_from,
        "steps": found.steps,
        "misfit": found.misfit,
        "misfit_limit": found.limit,
        "parameters": parameters,
        "residuals": dict(zip(rows, found.far.tolist(), strict=True)),
        "far": [row for row, far in zip(rows, found.far, strict=True) if abs(far) > FAR],
        "unknown": [name for name, one in parameters.items() if one["unknown"]],
    }


def table(report: dict[str, Any]) -> str:
    """Return the report as people read it."""
    lines = [f"{'parameter':28}{'value':>12}{'error':>11}{'before':>11}"]
    for name, one in report["parameters"].items():
        if name == OWN_LAYER:
            continue
        several = len(one["values"]) > 1
        for k, (value, error, prior) in enumerate(
            zip(one["values"], one["standard_errors"], one["prior_errors"], strict=True)
        ):
            shown = f"{name}[{k}]" if several else name
            lines.append(f"{shown:28}{value:12.5g}{error:11.2g}{prior:11.2g} {one['unit']}".rstrip())
    far = np.abs(list(report["residuals"].values()))
    lines.append(
        f"residuals over their noise: rms {np.sqrt(np.mean(far**2)):.2f}, largest {far.max():.1f}; misfit "
        f"{report['misfit']:.2f}, chance allows {report['misfit_limit']:.2f}"
    )
    if report["far"]:
        lines.append(f"rows beyond {FAR:g}: {', '.join(report['far'])}")
    lines.append(f"still unknown: {', '.join(report['unknown']) or 'nothing'}")
    return "\n".join(lines)
