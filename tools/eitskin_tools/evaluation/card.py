"""A bundle's card: what its network scores under N2 of 50 dB, by contrast and by mismatch, ideal and on other devices.

Every part is a few rows of ``eitskin evaluate --devices``: true devices are solved, the network assumes the nominal
one. A calibrated skin is a device itself, and no others are drawn; its card has touches of several contrasts on it, and
the held-out samples of its data, whose devices are as random as the data's.
"""

from pathlib import Path
from typing import Any, Final

from eitskin.model.bundle import Bundle, load_bundle
from eitskin_proto.skin.skin import Skin
from eitskin_sim.evaluation import device_runs as runs
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.harness import Conditions
from eitskin_sim.evaluation.mismatch import IDEAL, LAB, Mismatch, Row, load_rows
from eitskin_sim.scene.parts import Phantom
from eitskin_tools.command_line import files
from eitskin_tools.evaluation.devices import trials_of
from eitskin_tools.evaluation.solvers import Request, judge_of, named, touched_trial

RAISING_CONTRASTS: Final = (50.0, 10.0, 5.0, 3.0, 2.0, 1.5)
"""Contrasts of 10 mm squares, or of units."""

LOWERING_CONTRASTS: Final = (0.2, 0.4, 0.6, 0.8)
"""Contrasts of 16 mm squares and discs with borders of 4 mm, or of units."""

CARD_MISMATCHES: Final = (
    "electrodes off by 1 mm", "gauge factor +1", "gauge factor -1", "drift +10 %", "uneven drift of 5 %",
    "reference stretched 1 %", "scan noise 1 mm",
)  # fmt: skip
"""Of the shipped list, beside none, random devices and the lab mix."""


def parts(path: Path) -> list[str]:
    """Return the names of the parts that a bundle's card has."""
    bundle = load_bundle(path, lazily=True)
    found = [f"contrast-{contrast:g}" for contrast in _contrasts(bundle)]
    if not bundle.skin.calibrated_from:
        found += [f"mismatch-{number}" for number in range(len(_mismatches()))]
    return found


def part(name: str, path: Path, deformations: int, each: int, draws: int) -> list[dict[str, Any]]:
    """Return the rows of one part.

    Args:
        name: One of :func:`parts`.
        path: The bundle.
        deformations: Unseen ones.
        each: Touches at each of them.
        draws: Devices of each mismatch.
    """
    kind, _, which = name.partition("-")
    bundle = load_bundle(path)
    if kind == "mismatch":
        return _rows([_mismatches()[int(which)]], _trials(bundle, deformations, each), bundle, draws)
    contrast = float(which)
    if bundle.skin.calibrated_from:
        return _of_a_device(bundle, contrast, deformations, each)
    if bundle.labels == "units":
        rows: list[Row] = [(f"contrast {contrast:g}", Mismatch(contrast=contrast))]
        return _rows(rows, trials_of(["units"], deformations, each, bundle.skin), bundle, draws)
    touched = runs.Trial("touch", tuple(_touches(contrast, deformations, each, bundle.skin)), lowering=True)
    return _rows([("none", IDEAL), ("random", None)], [touched], bundle, draws)


def whole(found: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the card of its parts: {by_contrast: [...], by_mismatch: [...]}, and what they were measured with."""
    by_contrast = [
        {"contrast": float(name.partition("-")[2]), "rows": rows}
        for name, rows in found.items()
        if name.startswith("contrast")
    ]
    by_mismatch = [row for name, rows in found.items() if name.startswith("mismatch") for row in rows]
    card = {"noise": "N2", "snr_db": 50.0, "solver": "vd2t", "by_contrast": by_contrast, "by_mismatch": by_mismatch}
    held_out = load_bundle(path, lazily=True).manifest.get("metrics", {}).get("held_out")
    return {**card, "unseen_deformations_of_the_data": held_out}


def lines_of(card: dict[str, Any]) -> list[str]:
    """Return a card as lines for people."""
    lines = []
    for one in card["by_contrast"]:
        cells = [f"{_device(row)}: {_figures(row)}" for row in one["rows"]]
        lines.append(f"contrast {one['contrast']:g}, {'; '.join(cells)}")
    lines += [f"{_device(row)}: {_figures(row)}" for row in card["by_mismatch"]]
    return lines


def summary(card: dict[str, Any]) -> str:
    """Return a card's accuracy in a sentence: on random devices if it has any, else at its first contrast."""
    row = next((one for one in card["by_mismatch"] if one["name"] == "random"), None)
    row = card["by_contrast"][0]["rows"][0] if row is None else row
    return f"Accuracy on {_device(row)}: {_figures(row)}."


def _device(row: dict[str, Any]) -> str:
    """Return what the row's devices are, in words."""
    return {"none": "ideal device", "random": "random devices"}.get(row["name"], str(row["name"]))


def _figures(row: dict[str, Any]) -> str:
    cells = []
    for trial, one in row.items():
        if isinstance(one, dict) and "cc" in one:
            missed = f", missed {100 * one['missed']:.0f} %" if one["missed"] else ""
            cells.append(f"{'' if trial == 'touch' else f'{trial} '}CC {one['cc']:.3f}{missed}")
    return ", ".join(cells) or "-"


def _contrasts(bundle: Bundle) -> tuple[float, ...]:
    if bundle.labels == "units" and bundle.skin.calibrated_from:
        return RAISING_CONTRASTS[:1]  # drawn units have the paper's contrast
    lowering = LOWERING_CONTRASTS if bundle.touch_kind != "raise" else ()
    return lowering + (RAISING_CONTRASTS if bundle.touch_kind != "lower" else ())


def _mismatches() -> list[Row]:
    listed = dict(load_rows(files.find("single", files.MISMATCHES)))
    return [("none", IDEAL), ("random", None), ("lab mix", LAB), *((name, listed[name]) for name in CARD_MISMATCHES)]


def _trials(bundle: Bundle, deformations: int, each: int) -> list[runs.Trial]:
    """Return the trials of a bundle's labels and touches."""
    if bundle.labels == "units":
        return trials_of(["units"], deformations, each, bundle.skin)
    kinds = {"raise": ["mm", "single"], "lower": ["press04", "press06"]}
    wanted = kinds.get(bundle.touch_kind, [*kinds["raise"], *kinds["lower"]])
    return trials_of(wanted, deformations, each, bundle.skin)


def _touches(contrast: float, deformations: int, each: int, skin: Skin) -> list[Phantom]:
    """Return phantoms of one touch of a contrast: a hard square, or by turns a soft square and a soft disc."""
    if contrast > 1.0:
        return trials.single(runs.SINGLE_MM, deformations, each, "A", trials.TouchProfile(contrast), skin)
    return list(runs.presses(contrast, deformations, each, skin))


def _rows(rows: list[Row], kinds: list[runs.Trial], bundle: Bundle, draws: int) -> list[dict[str, Any]]:
    request, skin = Request("vd2t", "pre", bundle.path), bundle.skin
    solvers = {one.name: named(request, one.labels, skin).run for one in kinds}
    judges = {one.name: judge_of(bundle) for one in kinds}
    return runs.run_rows(rows, kinds, solvers, judges, runs.Plan(draws, skin=skin, meant=skin))


def _of_a_device(bundle: Bundle, contrast: float, deformations: int, each: int) -> list[dict[str, Any]]:
    conditions = Conditions("N2", skin=bundle.skin)
    if bundle.labels == "units":
        phantoms = trials.random((1, 2), deformations, each, "A", "units", bundle.skin)
    else:
        phantoms = _touches(contrast, deformations, each, bundle.skin)
    found = touched_trial(phantoms, each, Request("vd2t", bundle=bundle.path), conditions, None)
    figures = {key: found[key] for key in ("maps", "cc", "localisation_rms_mm", "missed")}
    return [{"name": "none", "devices": [{}], "touch": figures}]
