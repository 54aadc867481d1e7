"""The card of a bundle without a network: both of its solvers on drawn touches of its skin, at bends it never saw."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin.model.bundle import Bundle, load_bundle
from eitskin.model.engine import SCALED
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.skin.skin import Skin
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.harness import Conditions
from eitskin_sim.evaluation.metrics import score
from eitskin_sim.evaluation.report import mean_scores
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.tank.round_sheet import RoundSheet
from eitskin_tools.evaluation.solvers import Request, evaluate_named

DEFORMATIONS: Final = 5
EACH: Final = 2
"""Touches at each deformation, one at a time."""

Results = dict[str, list[Any]]
"""Scores by solver."""


def card_of(path: Path) -> dict[str, Any]:
    """Return the card of a bundle: {"size_mm", "contrast", "maps", "solvers": {name: {"cc", "localisation_mm", ..}}}.

    Args:
        path: The bundle.
    """
    bundle = load_bundle(path)
    skin = bundle.skin
    size_mm, contrast = _touch_of(skin)
    if skin.outline.kind == "disc":
        results = _on_a_disc(bundle, size_mm, contrast)
    else:
        profile = trials.TouchProfile(contrast, float(np.mean(skin.touches.border_mm)), disc=True)
        phantoms = trials.single(size_mm, DEFORMATIONS, EACH, "A", profile, skin)
        requests = [Request(name, bundle=path) for name in SCALED]
        snr_db = float(np.mean(skin.front_end.snr_db))
        found = evaluate_named(phantoms, requests, Conditions(skin.front_end.noise, snr_db, skin=skin))
        results = {
            request.name: [one for _, scores in own for one in scores]
            for request, (_, own) in zip(requests, found, strict=True)
        }
    rounded = {name: _figures(scores) for name, scores in results.items()}
    count = len(next(iter(results.values())))
    stated = bundle.manifest["gate"]
    gate = {key: stated[key] for key in ("false_alarm_rate", "missed_rate", "felt_mm") if key in stated}
    return {"size_mm": size_mm, "contrast": contrast, "maps": count, "solvers": rounded, "gate": gate}


def summary(card: dict[str, Any]) -> str:
    """Return a card's verdict in a sentence."""
    name = next(iter(card["solvers"]))
    best = card["solvers"][name]
    return (
        f"{name} finds touches of {card['size_mm']:.3g} mm within {best['localisation_median_mm']:.1f} mm (median), "
        f"CC {best['cc']:.2f}; no cloud needed."
    )


def lines_of(card: dict[str, Any]) -> list[str]:
    """Return a card as lines for people."""
    lines = [
        f"{name}: CC {one['cc']:.3f}, localisation {one['localisation_median_mm']:.1f} mm median, "
        f"{one['localisation_mm']:.1f} mm mean"
        for name, one in card["solvers"].items()
    ]
    gate = card["gate"]
    rates = f"{100 * gate['false_alarm_rate']:.1f} % false alarms, {100 * gate['missed_rate']:.1f} % of touches missed"
    return [
        f"{card['maps']} touches of {card['size_mm']:.3g} mm and contrast {card['contrast']:.2g}, at unseen bends:",
        *lines,
        f"gate, single frames at unseen bends: {rates}",
        *([_felt_said(gate["felt_mm"])] if "felt_mm" in gate else []),
    ]


def _felt_said(felt_mm: float | None) -> str:
    """Return which touches the sheet feels, in words."""
    if felt_mm is None:
        return "the sheet feels no size in [touches] reliably: expect larger or stronger touches, or bend it less"
    return f"the sheet feels 9 of 10 touches of {felt_mm:.0f} mm or more; unseen bends hide many smaller ones"


def _touch_of(skin: Skin) -> tuple[float, float]:
    """Return size and contrast of a usual touch: the geometric means of the skin's ranges."""
    touches = skin.touches
    ranges = touches.raising_contrast if touches.higher else touches.lowering_contrast
    size_mm, contrast = (float(np.exp(np.mean(np.log(one)))) for one in (touches.size_mm, ranges))
    return round(size_mm, 1), contrast


def _figures(scores: list[Any]) -> dict[str, float]:
    away = [one.localisation_mm for one in scores]
    means = mean_scores(scores)
    return {
        "cc": round(means["cc"], 4),
        "localisation_mm": round(means["localisation_mm"], 2),
        "localisation_median_mm": round(float(np.median(away)), 2),
    }


def _on_a_disc(bundle: Bundle, size_mm: float, contrast: float) -> Results:
    from eitskin.model.buffers import Buffers
    from eitskin.model.engine import engines

    skin, rng = bundle.skin, np.random.default_rng(trials.SEED)
    sheet, buffers = RoundSheet(skin), Buffers(bundle)
    flat, radius = sheet.voltages(), skin.outline.size_mm[0] / 2
    centres = skin.grid.pixel_centres_mm()
    results: Results = {name: [] for name in SCALED}
    for bend in trials.deformations_of(DEFORMATIONS, "A", sheet.square):
        for _ in range(EACH):
            angle, away = rng.uniform(0.0, 2.0 * np.pi), (radius - size_mm / 2) * np.sqrt(rng.random())
            x, y = radius + away * np.cos(angle), radius + away * np.sin(angle)
            volts = sheet.voltages(bend, [(x, y, size_mm / 2, contrast)])
            snr_db = float(np.mean(skin.front_end.snr_db))
            noisy = add_noise(volts, flat, skin.front_end.noise, snr_db, rng)
            buffers.change[0] = relative_change(noisy, flat)
            apart = np.linalg.norm(centres - (x, y), axis=-1)
            truth = np.clip((size_mm / 2 - apart) / skin.grid.pitch_mm + 0.5, 0.0, 1.0)
            for engine in engines(bundle, buffers):
                engine.infer()
                image = buffers.map[0].reshape(skin.grid.shape).astype(np.float64)
                results[engine.name].append(score(image, truth, labels="area", grid=skin.grid))
    return results
