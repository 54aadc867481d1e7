"""Averages scores over noise draws, phantoms and deformations.

A phantom's measure is its mean over the draws, the mean's is the mean over the phantoms that have it: DE and the
two-point distance exist only where the truth has two touches or more, CC and RIE where it has one. What is infinite or
undefined becomes None, so that the report is JSON.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation.harness import Results
from eitskin_sim.evaluation.metrics import Score, lost_mm
from eitskin_sim.scene.parts import Phantom

MEASURES: Final = (
    "cc",
    "psnr_db",
    "rie",
    "localisation_mm",
    "exact",
    "touches",
    "true_touches",
    "count_right",
    "two_point_mm",
    "distance_error",
)
"""The reported values of each phantom and of their mean: the fields of a score, and the share of right counts."""

MAX_RESOLVED_DISTANCE_MM: Final = 5.0
"""Touches count as resolved if all are found within this distance: half the width of a touch."""

RESAMPLES: Final = 2000
"""Bootstrap draws of deformations behind an interval."""

Row = dict[str, float | None]


def measures_of(one: Score) -> dict[str, float]:
    """Return the measures of one map; NaN for what it has none of: CC and RIE compare it with touches."""
    found = {name: float(getattr(one, name)) for name in MEASURES if name != "count_right"}
    found["count_right"] = float(one.touches == one.true_touches)
    if not one.true_touches:
        found["cc"] = found["rie"] = math.nan
    if math.isnan(one.distance_error):
        found["two_point_mm"] = math.nan
    return found


def mean_scores(scores: Sequence[Score]) -> dict[str, float]:
    """Return the mean of each of ``MEASURES``; one that is infinite stays so, one that no score has is NaN."""
    rows = [measures_of(one) for one in scores]
    return {name: _mean([row[name] for row in rows]) for name in MEASURES}


def report(solver: str, noise: str, results: Results) -> dict[str, Any]:
    """Return the results as the object that ``eitskin evaluate --json`` prints."""
    means = [mean_scores(scores) for _, scores in results]
    phantoms = [{"name": phantom.name, **_finite(row)} for (phantom, _), row in zip(results, means, strict=True)]
    mean = {name: _mean([row[name] for row in means]) for name in MEASURES}
    return {"solver": solver, "noise": noise, "phantoms": phantoms, "mean": _finite(mean)}


def summary(results: Results, each: int, grid: Grid = PAPER.grid) -> dict[str, Any]:
    """Return the summary of trials at several deformations.

    Args:
        results: ``each`` phantoms in a row for each deformation.
        each: How many belong to one deformation.
        grid: The maps'.
    """
    groups = [results[start : start + each] for start in range(0, len(results), each)]
    cc = [mean_scores([one for _, scores in group for one in scores])["cc"] for group in groups]
    every = [one for _, scores in results for one in scores]
    distance = np.array([one.localisation_mm for one in every])
    right = np.array([one.touches == one.true_touches for one in every])
    worst = int(np.argmin(np.nan_to_num(cc, nan=np.inf)))
    return {
        "maps": len(every),
        **_finite(mean_scores(every)),
        "worst_deformation": worst,
        "worst_deformation_cc": _finite({"cc": cc[worst]})["cc"],
        "localisation_rms_mm": float(np.sqrt(np.mean(distance**2))),
        "localisation_median_mm": float(np.median(distance)),
        "localisation_p95_mm": float(np.percentile(distance, 95)),
        "missed": float(np.mean(distance >= lost_mm(grid))),
        "told_apart": float(np.mean(right & (distance <= MAX_RESOLVED_DISTANCE_MM))),
        "interval_95": _intervals(groups, lost_mm(grid)),
        "deformations": [
            {"bend": _bend(group[0][0]), **_finite({"cc": mean})} for group, mean in zip(groups, cc, strict=True)
        ],
    }


def _intervals(groups: Sequence[Results], lost: float) -> dict[str, list[float]]:
    """Return 95 % intervals by bootstrap over deformations, since the maps of one deformation err alike."""
    if len(groups) < 2:
        return {}
    cc = [[one.cc for _, scores in group for one in scores] for group in groups]
    distance = [[one.localisation_mm for _, scores in group for one in scores] for group in groups]
    sums = np.array(
        [
            (np.nansum(ccs), np.sum(~np.isnan(ccs)), np.sum(np.square(mm)), np.sum(np.array(mm) >= lost), len(mm))
            for ccs, mm in zip(cc, distance, strict=True)
        ]
    )
    drawn = np.random.default_rng(0).integers(len(groups), size=(RESAMPLES, len(groups)))
    cc_sum, cc_count, square, missed, maps = sums[drawn].sum(axis=1).T
    found = {"cc": cc_sum / cc_count, "localisation_rms_mm": np.sqrt(square / maps), "missed": missed / maps}
    return {name: [float(end) for end in np.percentile(values, (2.5, 97.5))] for name, values in found.items()}


def _bend(phantom: Phantom) -> dict[str, Any]:
    bend = phantom.scene.bend
    return {name: getattr(bend, name) for name in type(bend).__dataclass_fields__}


def _mean(values: Sequence[float]) -> float:
    there = [value for value in values if not math.isnan(value)]
    return float(np.mean(there)) if there else math.nan


def _finite(values: dict[str, float]) -> Row:
    return {name: value if math.isfinite(value) else None for name, value in values.items()}
