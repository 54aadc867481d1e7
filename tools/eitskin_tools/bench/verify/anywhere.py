"""Rows of touches anywhere: shapes verified, their maps scored beside the network's own."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation.harness import Case, Sheet
from eitskin_sim.evaluation.metrics import Score, lost_mm, score
from eitskin_sim.evaluation.near import NEAR_MM
from eitskin_sim.evaluation.truth import truth_map
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.touch_prior import touch_prior
from eitskin_tools.bench.verify.allowed import Allowed
from eitskin_tools.bench.verify.conditions import Anywhere
from eitskin_tools.bench.verify.truth import SEED, cloud_of, device_of, volts
from eitskin_tools.bench.verify.units import counted
from eitskin_tools.evaluation.solvers import Request, named
from eitskin_tools.evaluation.verified.solver import Verified

Row = dict[str, Any]


def row(condition: Anywhere, deformations: int, each: int) -> Row:
    """Return the figures of a condition, its p-values among them."""
    phantoms = condition.phantoms(deformations, each)
    kind = phantoms[0].scene.touch_kind
    network = named(Request("vd2t"), "area", touches=kind).run
    told_of = Noise(condition.noise)
    verified = Verified(network, told_of, "area", kind, PAPER, at_rest=condition.at_rest)
    found, scores = [], []
    allowed = Allowed(told_of, touch_prior(kind, PAPER))
    for number in range(deformations):
        own = phantoms[number * each : (number + 1) * each]
        device = device_of(condition.mismatch, number)
        flat = volts(device.reference())
        untouched = (
            volts(device.scene(own[0].scene.untouched(), as_it_is=True))
            if condition.at_rest
            else np.full(len(flat), np.nan)
        )
        sheet = Sheet(cloud_of(device, own[0].scene.bend, number), untouched)
        allowed.deform(sheet.cloud_mm)
        rng = np.random.default_rng([SEED, number, 2])
        for phantom in own:
            scene = device.scene(phantom.scene, as_it_is=kind != "raise")
            noisy = add_noise(volts(scene), flat, condition.noise, 50.0, rng)
            case = Case(noisy, flat, flat, sheet, "area", kind == "lower")
            truth = truth_map(replace(phantom, scene=replace(phantom.scene, touches=scene.touches)))
            alone, checked = (score(solve(case), truth, labels="area") for solve in (network.solver, verified.solve))
            found.append((told(alone), told(checked), verified.checked[-1]))
            scores.append((alone, checked))
            allowed.add(scene)
    return {"what": condition.name, **_figures(scores), **allowed.figures(), **counted(found)}


def told(one: Score) -> bool:
    """Return whether a map has as many touches as there are, each where it is."""
    return one.touches == one.true_touches and one.localisation_mm <= NEAR_MM


def _figures(scores: Sequence[tuple[Score, Score]]) -> Row:
    found: Row = {"maps": len(scores)}
    for index, name in ((0, "network_"), (1, "")):
        own = [one[index] for one in scores]
        distance = np.array([one.localisation_mm for one in own if one.localisation_mm < lost_mm(PAPER.grid)])
        found |= {
            f"{name}right": float(np.mean([told(one) for one in own])),
            f"{name}cc": float(np.mean([one.cc for one in own])),
            f"{name}cc_worst": float(np.min([one.cc for one in own])),
            f"{name}localisation_median_mm": float(np.median(distance)) if len(distance) else None,
            f"{name}localisation_rms_mm": float(np.sqrt(np.mean(distance**2))) if len(distance) else None,
        }
    return found
