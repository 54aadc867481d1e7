"""The result of a calibration for people: a verdict, then a line for each group of parameters."""

from typing import Any, Final

import numpy as np

from eitskin_sim.calibration.fit import NAMED_ROW_SD
from eitskin_sim.calibration.stamp import PLACE, PRESS_CONTRAST

SHOWN_ROWS: Final = 8
"""Rows that a line names; ``--json`` has all."""


def verdict(report: dict[str, Any]) -> str:
    """Return whether the sheet explains the readings, its front end, and what was learned and not, in four lines."""
    unknown, press, rows = report["unknown"], report["press"], len(report["residuals"])
    learned = ", ".join(name for name in _shown(report) if name not in unknown) or "nothing"
    if report["explained"]:
        lines = [
            f"Calibrated: the sheet explains all {rows} rows (misfit {report['misfit']:.2f}, at most "
            f"{report['misfit_limit']:.2f} expected)."
        ]
    else:
        one = max(report["unexplained"], key=lambda one: one["misfit"] / one["limit"])
        lines = [
            f"NOT explained: {one['name']}: misfit {one['misfit']:.3g}, at most {one['limit']:.3g} expected; "
            f"{rows - len(report['far'])} of {rows} rows of the reference are explained; worst, in units of noise: "
            f"{one['rows']}."
        ]
    offset, current = report["offset_V"], report["current_A"]
    lines += [
        f"Front end: {abs(current):.3g} A{', inverted signs' if current < 0 else ''}, offset "
        f"{abs(current) * offset['value']:.4g} +- {abs(current) * offset['error']:.2g} V.",
        f"Learned: {learned}. Still unknown: {', '.join(unknown) or 'nothing'}.",
    ]
    if press is None:
        lines.append("No presses: which way touches go is not measured ('eitskin doctor --touch' measures it).")
        return "\n".join(lines)
    size = " x ".join(f"{one:.1f}" for one in press["size_mm"])
    stated, kind = report["stated_kind"], "lower" if press["contrast"] < 1.0 else "raise"
    lines.append(
        f"A press: contrast {press['contrast']:.3g} +- {press['contrast_error']:.2g}, {size} mm "
        f"+- {press['size_error_mm']:.2g}, border {press['border_mm']:.2g} +- {press['border_error_mm']:.2g} mm; "
        f"touches {kind} conductance{'' if stated in (kind, 'both') else f', where the stated skin says {stated}'}."
    )
    return "\n".join(lines)


def table(report: dict[str, Any]) -> str:
    """Return a line for each group of parameters, bend and press; ``--json`` has every value and residual."""
    lines = [f"{'parameter':29}{'values':>25}{'error':>10}{'before':>10}"]
    for name, one in _shown(report).items():
        values = sorted({f"{value:.5g}" for value in (min(one["values"]), max(one["values"]))}, key=float)
        error, prior = max(one["standard_errors"]), max(one["prior_errors"])
        shown = f"{name} ({len(one['values'])})" if len(one["values"]) > 1 else name
        lines.append(f"{shown:29}{' to '.join(values):>25}{error:10.2g}{prior:10.2g} {one['unit']}".rstrip())
    if report["current_A"] != 1.0:
        lines.append(
            f"current: about {report['current_A']:.2g} A if the layer conducts as stated; level and offsets are for 1 A"
        )
    far = np.abs(list(report["residuals"].values()))
    lines.append(
        f"reference: residuals {np.sqrt(np.mean(far**2)):.2f} times their noise (rms), at most {far.max():.1f}"
    )
    if report["far"]:
        lines.append(f"rows beyond {NAMED_ROW_SD:g}: {_some(report['far'])}")
    for name, moment in report["moments"].items():
        beyond = f"; rows beyond {NAMED_ROW_SD:g}: {_some(moment['far'])}" if moment["far"] else ""
        lines.append(f"{name}: misfit {moment['misfit']:.2f}{_press(moment['press'])}{beyond}")
    if report["reference_scan"] is not None:
        scan = report["reference_scan"]
        lines.append(
            f"scan of the reference: what it does not show changes rows by {scan['unseen_rms']:.2%} (rms), expected "
            f"{scan['expected_rms']:.2%}"
        )
    return "\n".join(lines)


def _shown(report: dict[str, Any]) -> dict[str, Any]:
    """Return the groups of parameters but for those of each press, which stand with it."""
    return {name: one for name, one in report["parameters"].items() if name not in (PRESS_CONTRAST, PLACE)}


def _some(rows: list[str]) -> str:
    """Return the first names, and how many more there are."""
    more = f", and {len(rows) - SHOWN_ROWS} more" if len(rows) > SHOWN_ROWS else ""
    return f"{', '.join(rows[:SHOWN_ROWS])}{more}"


def _press(own: dict[str, Any] | None) -> str:
    """Return a press's own strength and place, to follow its misfit; empty for a bend."""
    if own is None:
        return ""
    (x, y), (error_x, error_y) = own["off_mm"], own["off_error_mm"]
    return (
        f"; log contrast {own['strength']:.2f} +- {own['strength_error']:.2f} times the stamp's, place off by "
        f"({x:.1f} +- {error_x:.1f}, {y:.1f} +- {error_y:.1f}) mm"
    )
