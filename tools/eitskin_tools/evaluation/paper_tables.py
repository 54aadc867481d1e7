"""The table of the documentation: every solver, every reference, beside the paper's Table II; as Markdown."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_proto.files.plain import plain
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.evaluation.harness import Conditions
from eitskin_sim.scene.parts import Phantom
from eitskin_tools.evaluation.paper import DISTANCE_ERROR, PHANTOMS, TABLE_2
from eitskin_tools.evaluation.solvers import Progress, Request, evaluate_requests

CLASSICAL: Final = tuple(f"{name}-{cells}" for name in ("tikhonov", "l1", "sbl") for cells in ("pixels", "units"))
"""Classical solvers of the table."""

PER_PHANTOM: Final = (("cc", "CC", 3), ("psnr_db", "PSNR, dB", 1), ("rie", "RIE", 3))
"""Measures of the paper's Table II, with their names and decimals."""

MEANS: Final = (
    ("cc", "CC", 3),
    ("psnr_db", "PSNR, dB", 1),
    ("rie", "RIE", 3),
    ("localisation_mm", "localisation, mm", 2),
    ("exact", "exact set", 2),
    ("count_right", "count right", 2),
    ("touches", "touches", 2),
    ("two_point_mm", "two-point distance, mm", 1),
    ("distance_error", "DE", 3),
)
"""Measures of the table of means."""


def requests(phantoms: Sequence[Phantom], bundle: str | Path | None = None, skin: Skin = PAPER) -> list[Request]:
    """Return what the table compares: classical solvers with three references, and the network if its bundle is there.

    Args:
        phantoms: Their labels say which bundles are needed.
        bundle: The network's file; None takes the shipped ones, which are for the paper's skin.
        skin: Whose maps are compared.
    """
    found = [Request(name, reference) for name in CLASSICAL for reference in ("post", "pre", "predicted")]
    if bundle is not None or (skin.grid_id == PAPER.grid_id and _has_bundle(phantoms)):
        found += [Request("vd2t", bundle=bundle), Request("vd2t-int8", bundle=bundle)]
    return found


def comparison(
    phantoms: Sequence[Phantom],
    conditions: Conditions,
    progress: Progress | None = None,
    bundle: str | Path | None = None,
) -> tuple[str, list[dict[str, Any]]]:
    """Return the table as Markdown, and the reports it is made of.

    Args:
        phantoms: The eight of the paper's Table II, or others (then without the paper's columns).
        conditions: Noise, seeds, shifts.
        progress: Called with the phantoms done and all phantoms.
        bundle: The network's file; None takes the shipped ones.
    """
    reports = evaluate_requests(phantoms, requests(phantoms, bundle, conditions.skin), conditions, progress)
    own = [one for one in reports if one["reference"] == ("pre" if one["solver"].startswith("vd2t") else "post")]
    own = [one for one in own if one["solver"] != "vd2t-int8"]
    paper = len(phantoms) == PHANTOMS
    lines = [_conditions(conditions), ""]
    for measure, title, digits in PER_PHANTOM:
        header = ["phantom", *(one["solver"] for one in own)]
        rows = [
            [plain(phantom.name), *(_text(one["phantoms"][i][measure], digits) for one in own)]
            for i, phantom in enumerate(phantoms)
        ]
        rows.append(["**mean**", *(f"**{_text(one['mean'][measure], digits)}**" for one in own)])
        if paper:
            columns = TABLE_2[measure]
            header += [f"paper: {name}" for name in columns]
            for i, row in enumerate(rows[:-1]):
                row += [_text(values[i], digits) for values in columns.values()]
            rows[-1] += [f"**{_text(float(np.mean(values)), digits)}**" for values in columns.values()]
        lines += [f"{title}, classical solvers with the post-deformation reference:", "", *_table(header, rows), ""]
    lines += ["Means, by reference:", ""]
    rows = [
        [one["solver"], _reference(one), *(_text(one["mean"][measure], digits) for measure, _, digits in MEANS)]
        for one in reports
    ]
    if paper:
        rows += [_paper_row(name) for name in TABLE_2["cc"]]
    lines += _table(["solver", "reference", *(title for _, title, _ in MEANS)], rows)
    if paper:
        lines += ["", f"The paper gives DE = {DISTANCE_ERROR:.2%} for two touches 90 mm apart, in its experiment."]
    return "\n".join(lines), reports


def _conditions(conditions: Conditions) -> str:
    text = f"Noise {conditions.noise} at {conditions.snr_db:g} dB, {conditions.seeds} draw(s) of noise and cloud"
    return text + (f", touches shifted by up to {conditions.shift_px:g} pixel" if conditions.shift_px else "") + "."


def _reference(one: dict[str, Any]) -> str:
    return f"{one['reference']} + V_pred" if one["prediction"] == "scan" else str(one["reference"])


def _paper_row(name: str) -> list[str]:
    means = [_text(float(np.mean(TABLE_2[measure][name])), digits) for measure, _, digits in PER_PHANTOM]
    return [f"paper: {name}", "pre" if name == "vd2t" else "post", *means, *["-"] * (len(MEANS) - len(means))]


def _has_bundle(phantoms: Sequence[Phantom]) -> bool:
    from eitskin.model.bundle import default_path

    return all(default_path(phantom.truth).exists() for phantom in phantoms)


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *(f"| {' | '.join(row)} |" for row in rows)]
