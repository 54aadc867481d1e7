"""What calibration found, as people read it."""

from typing import Any

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.calibration.fit import NAMED_ROW_SD
from eitskin_sim.calibration.parameters import LAYER_MODES
from eitskin_sim.calibration.stamp import PLACE, PRESS_CONTRAST


def table(report: dict[str, Any]) -> str:
    """Return the report as people read it."""
    lines = [f"{'parameter':28}{'value':>12}{'error':>11}{'before':>11}"]
    for name, one in report["parameters"].items():
        if name in (PRESS_CONTRAST, PLACE):  # with its press
            continue
        if name == LAYER_MODES:
            lines.append(_layer(one))
            continue
        several = len(one["values"]) > 1
        for k, (value, error, prior) in enumerate(
            zip(one["values"], one["standard_errors"], one["prior_errors"], strict=True)
        ):
            shown = f"{name}[{k}]" if several else name
            lines.append(f"{shown:28}{value:12.5g}{error:11.2g}{prior:11.2g} {one['unit']}".rstrip())
    if report["current_A"] != 1.0:
        lines.append(
            f"read under about {report['current_A']:.2g} A, if the layer conducts as stated; level and offsets are for "
            "1 A"
        )
    far = np.abs(list(report["residuals"].values()))
    lines.append(
        f"residuals over their noise: rms {np.sqrt(np.mean(far**2)):.2f}, largest {far.max():.1f}; misfit "
        f"{report['misfit']:.2f}, chance allows {report['misfit_limit']:.2f}"
    )
    lines += _by_pairs(report["residuals"])
    if report["far"]:
        lines.append(f"rows beyond {NAMED_ROW_SD:g}: {', '.join(report['far'])}")
    for name, moment in report["moments"].items():
        beyond = f"; rows beyond {NAMED_ROW_SD:g}: {', '.join(moment['far'])}" if moment["far"] else ""
        lines.append(f"{name}: misfit {moment['misfit']:.2f}{_press(moment['press'])}{beyond}")
    if report["reference_scan"] is not None:
        scan = report["reference_scan"]
        lines.append(
            f"reference: as it was scanned; what the scan does not show moves its rows by {scan['unseen_rms']:.2%} "
            f"(rms), expected {scan['expected_rms']:.2%}"
        )
    press = report["press"]
    if press is not None:
        size = " x ".join(f"{one:.1f}" for one in press["size_mm"])
        lines.append(
            f"a press: contrast {press['contrast']:.3g} +- {press['contrast_error']:.2g}, {size} mm "
            f"+- {press['size_error_mm']:.2g}, border {press['border_mm']:.2g} +- {press['border_error_mm']:.2g} mm"
        )
    lines.append(f"still unknown: {', '.join(report['unknown']) or 'nothing'}")
    return "\n".join(lines)


def _layer(modes: dict[str, Any]) -> str:
    """Return the modes of the layer's log conductivity in a line."""
    values, errors = np.array(modes["values"]), np.array(modes["standard_errors"])
    return (
        f"layer: {len(values)} modes of its unevenness, {values.min():.2g} to {values.max():.2g}, errors "
        f"{errors.min():.2g} to {errors.max():.2g}, before 1"
    )


def _press(own: dict[str, Any] | None) -> str:
    """Return a press's own strength and place, to follow its misfit; empty of a bend."""
    if own is None:
        return ""
    (x, y), (error_x, error_y) = own["off_mm"], own["off_error_mm"]
    return (
        f"; log contrast {own['strength']:.2f} +- {own['strength_error']:.2f} times the stamp's, place off by "
        f"({x:.1f} +- {error_x:.1f}, {y:.1f} +- {error_y:.1f}) mm"
    )


def _by_pairs(residuals: dict[str, float]) -> list[str]:
    """Return the residual of every row over its noise: a line a drive, a column a measured pair."""
    found = {tuple(int(word) for word in name.split()[1::2]): value for name, value in residuals.items()}
    lines = [f"{'drive / measure':15}" + "".join(f"{pair:6d}" for pair in range(N_ELECTRODES))]
    for drive in range(N_ELECTRODES):
        row = "".join(
            f"{found[drive, pair]:6.1f}" if (drive, pair) in found else f"{'':6}" for pair in range(N_ELECTRODES)
        )
        lines.append(f"{drive:15d}{row}".rstrip())
    return lines
