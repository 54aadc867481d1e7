"""Scores a solver on measured samples, one by one and by kind, in the order of a stream.

The samples are processed in the order of measurement. Each is compared with the one reference; the bundle's touch gate
judges it, and the solver makes its map, which is scored like a phantom's. If the reference has a scan, the scan shows
the sheet's shape at its capture. A flat sheet would then have read

    V_flat = V_reference * V_model(flat) / V_model(reference's scan)

which replaces the reference and shifts both inputs of a network.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.plain import plain
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation.harness import Case, Reference, Sheet
from eitskin_sim.evaluation.metrics import correlation, distances_mm, localisation_error_mm, missed_and_rms
from eitskin_sim.surface.predict import flat_voltages, predict
from eitskin_tools.evaluation.measured_file import UNTOUCHED, Measured
from eitskin_tools.evaluation.printed import cell
from eitskin_tools.evaluation.solvers import Progress, Request, bundle_on, is_deployed, judge_of, named
from eitskin_tools.evaluation.verified.untouched_samples import MIN_SAMPLES, UntouchedSamples

if TYPE_CHECKING:
    from eitskin_tools.evaluation.verified.solver import MapVerdict

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SampleScore:
    """What one sample's map is worth."""

    kind: str
    touched: bool
    """As the gate says; without a gate every frame is taken for touched."""
    peak: float
    """Highest value of the map."""
    true_touches: int | None
    """None where no truth is known."""
    cc: float | None = None
    """None where nothing touches, or no truth is known."""
    localisation_mm: float | None = None
    """Between true and found touches, both ways."""
    distances_mm: tuple[float, ...] = ()
    """From every true touch to the nearest found one; infinite where there is none."""
    checked: "MapVerdict | None" = None
    """What physics says of it; None where the solver does not ask."""


def evaluate_measured(measured: Measured, request: Request, progress: Progress | None = None) -> dict[str, Any]:
    """Return the object that ``eitskin evaluate --measured --json`` prints.

    Args:
        measured: The samples.
        request: Solver, reference ("pre" or "predicted"), bundle.
        progress: Called with the samples done and all samples.

    Raises:
        ValueError: The request needs the untouched, bent sheet, which was not measured.
        BundleError: The bundle cannot be used.
    """
    if request.reference == "post":
        raise ValueError(
            "--reference post needs the untouched voltages at every shape, which a measured file does not have"
        )
    classical = not is_deployed(request)
    reference: Reference = request.reference or ("predicted" if classical else "pre")
    kind, skin = touches_of(measured), measured.skin
    bundle = bundle_on(request, "area", kind, skin)
    labels: Literal["units", "area"] = "units" if bundle is not None and bundle.labels == "units" else "area"
    path = None if bundle is None else bundle.path
    flat = _flat_reference(measured)
    is_untouched = np.array(measured.kinds) == UNTOUCHED
    rest = UntouchedSamples.of(measured.voltages_V / flat - 1.0, measured.cloud_index, is_untouched)
    noise = None if rest is None else rest.noise
    solver = named(Request(request.name, reference, path, request.prediction), labels, skin, kind, noise=noise)
    judge = judge_of(bundle)
    sheets: dict[int, Sheet] = {}
    last = {int(scan): number for number, scan in enumerate(measured.cloud_index)}
    scores = []
    for number, (volts, scan) in enumerate(zip(measured.voltages_V, measured.cloud_index.tolist(), strict=True)):
        if scan not in sheets:
            sheets[scan] = _sheet(measured, scan)
            at_rest = measured.voltages_V[is_untouched & (measured.cloud_index == scan)]
            if solver.verified is not None and len(at_rest) >= MIN_SAMPLES:
                solver.verified.use_untouched(at_rest.mean(axis=0), len(at_rest))
        sheet = sheets[scan]
        held = sheet.predicted() * flat / flat_voltages(skin) if reference == "predicted" else flat
        case = Case(volts, held, flat, sheet, labels, lowering=kind == "lower")
        truth = None if measured.truth is None else measured.truth[number]
        own = _score(solver.run.solver(case), truth, measured.kinds[number], judge(volts, flat), skin)
        if solver.verified is not None:
            checked = solver.verified.checked[-1]
            if rest is not None and not (checked.not_verified or checked.verdict.touches):
                checked = replace(checked, verdict=rest.verdict(number) or checked.verdict)
            own = replace(own, checked=checked)
        scores.append(own)
        if last[scan] == number:
            del sheets[scan]
        if progress is not None:
            progress(number + 1, len(measured.voltages_V))
    return {
        "solver": request.name,
        "reference": reference,
        "prediction": solver.prediction,
        "bundles": [] if bundle is None else [bundle.id],
        "skin_digest": skin.digest,
        "touch_kind": measured.touch_kind,
        "ignored": list(measured.ignored),
        "samples": [_sample(one) for one in scores],
        "by_kind": {
            kind: summary([one for one in scores if one.kind == kind]) for kind in dict.fromkeys(measured.kinds)
        },
    }


def touches_of(measured: Measured) -> TouchKind:
    """Return which way touches change conductance: as the file says, else as its skin's description does."""
    return measured.touch_kind or ("lower" if measured.skin.touch_kind == "lower" else "raise")


def _sheet(measured: Measured, scan: int) -> Sheet:
    unknown = np.full(measured.voltages_V.shape[1], np.nan)
    flat = measured.skin.grid.flat_cloud_mm()
    return Sheet(flat if scan < 0 else measured.clouds_mm[scan], unknown, measured.skin, is_certain=scan < 0)


def _flat_reference(measured: Measured) -> Array:
    if measured.reference_cloud_mm is None:
        return measured.reference_V
    skin = measured.skin
    return measured.reference_V * flat_voltages(skin) / predict(measured.reference_cloud_mm, skin)


def _score(image: Array, truth: Array | None, kind: str, touched: bool, skin: Skin) -> SampleScore:
    peak = float(image.max())
    if truth is None:
        return SampleScore(kind, touched, peak, None)
    nearest = distances_mm(image, truth, skin.grid)
    if not nearest.size:
        return SampleScore(kind, touched, peak, 0)
    cc, away = correlation(image, truth), localisation_error_mm(image, truth, skin.grid)
    return SampleScore(kind, touched, peak, len(nearest), cc, away, tuple(nearest))


def _sample(one: SampleScore) -> dict[str, Any]:
    found = {
        "kind": one.kind,
        "cc": one.cc,
        "localisation_mm": one.localisation_mm,
        "touched": one.touched,
        "peak": one.peak,
    }
    if one.checked is not None:
        verdict = one.checked.verdict
        found |= {"p_value": float(verdict.p_value), "flagged": bool(verdict.flagged), "extra_ms": one.checked.extra_ms}
    return found


def summary(scores: Sequence[SampleScore]) -> dict[str, Any]:
    """Return the figures of one kind; what its samples do not tell is None.

    Args:
        scores: Of the samples of this kind, at least one.
    """
    with_touches = [one for one in scores if one.true_touches]
    bare = [one for one in scores if one.true_touches == 0 or (one.true_touches is None and one.kind == "untouched")]
    cc = [one.cc for one in with_touches if one.cc is not None]
    distance = np.array([each for one in with_touches for each in one.distances_mm])
    missed, rms = missed_and_rms(distance)
    found = {
        "samples": len(scores),
        "cc": float(np.mean(cc)) if cc else None,
        "cc_worst": min(cc) if cc else None,
        "localisation_rms_mm": rms,
        "missed": missed,
        "gate_missed": float(np.mean([not one.touched for one in with_touches])) if with_touches else None,
        "false_touch": float(np.mean([one.touched for one in bare])) if bare else None,
    }
    return found | _verdicts([one.checked for one in scores if one.checked is not None])


def _verdicts(checked: "Sequence[MapVerdict]") -> dict[str, float]:
    """Return what physics says of the samples of one kind: as of a phantom's draws, or nothing."""
    if not checked:
        return {}
    return {
        "p_value": float(np.median([one.verdict.p_value for one in checked])),
        "flagged": float(np.mean([one.verdict.flagged for one in checked])),
        "extra_ms": float(np.median([one.extra_ms for one in checked])),
    }


def table(found: dict[str, Any]) -> str:
    """Return the figures by kind as people read them."""
    verified = any("p_value" in row for row in found["by_kind"].values())
    lines = [
        f"{found['solver']}, reference: {found['reference']}, {len(found['samples'])} samples",
        "kind            samples      CC   worst  rms mm  missed  gate missed  false touch"
        + ("       p  flagged      ms" if verified else ""),
    ]
    for kind, row in found["by_kind"].items():
        cells = [cell(row["cc"], 8, ".3f"), cell(row["cc_worst"], 8, ".3f")]
        cells += [cell(row["localisation_rms_mm"], 8, ".2f"), cell(row["missed"], 8, ".1%")]
        cells += [cell(row["gate_missed"], 13, ".1%"), cell(row["false_touch"], 13, ".1%")]
        if verified:
            cells += [cell(row["p_value"], 8, ".2g"), cell(row["flagged"], 9, ".1%"), cell(row["extra_ms"], 8, ".1f")]
        lines.append(f"{plain(kind):16}{row['samples']:7d}{''.join(cells)}")
    if found["ignored"]:
        lines.append(f"not read: {plain(', '.join(found['ignored']))}")
    return "\n".join(lines)
