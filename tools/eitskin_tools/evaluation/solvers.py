"""Solvers by name: the classical ones of the simulation, and the deployed network.

The network runs through the runtime's own engine: the bundle's graphs, the runtime's normalisation, and the one
reference taken flat and untouched. If its head has a second input, that is fed the way a robot feeds it: V_pred by the
forward model from the measured cloud, against the same model's flat sheet. It takes the shipped bundle whose labels and
touches match the phantoms, unless one is named.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle, load_bundle
from eitskin.model.engine import HEADS
from eitskin.model.engine import solvers as solvers_of
from eitskin.model.gate import Gate
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.skin.familiar_shape import unlike_family
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.harness import (
    REFERENCES,
    SOLVERS,
    Case,
    Conditions,
    Reference,
    Results,
    Run,
    Solver,
    evaluate_all,
)
from eitskin_sim.evaluation.metrics import TOUCHED
from eitskin_sim.evaluation.report import report, summary
from eitskin_sim.scene.parts import Phantom
from eitskin_sim.surface.predict import flat_voltages

if TYPE_CHECKING:
    from eitskin.model.bundle import Bundle
    from eitskin_sim.verification.residual import Noise
    from eitskin_tools.evaluation.verified.solver import MapVerdict, VerifiedNetwork

Prediction = Literal["scan", "none"]
"""What a head's second input is: V_pred of the cloud, or nothing."""

NETWORK: Final = "vd2t"
"""The solver of most bundles."""

NETWORKS: Final = tuple(HEADS)
"""Solvers that a bundle provides."""

VERIFIED: Final = "verified"
"""The map of the usual solver, checked by physics."""

NAMES: Final = (*SOLVERS, *NETWORKS, VERIFIED)
"""Every name that ``eitskin evaluate --solver`` takes."""

Progress = Callable[[int, int], None]

Group = tuple[str, TouchKind]
"""What decides which shipped bundle is meant: labels of the truth, and what touches."""


@dataclass(frozen=True, slots=True)
class Request:
    """One solver as a person asks for it."""

    name: str
    """One of ``NAMES``."""
    reference: Reference | None = None
    """None is what the solver is meant for: pre for a network, else post."""
    bundle: str | Path | None = None
    """A network's file; None takes the shipped one."""
    prediction: Prediction = "scan"
    """Of a network."""
    at_rest: int = 0
    """Untouched frames of each deformation that are verified first."""


@dataclass(frozen=True, slots=True)
class Named:
    """A solver, ready, and what a report says of it."""

    run: Run
    bundle_id: str | None = None
    """Of the network's bundle."""
    prediction: Prediction | None = None
    """What the head's second input is fed; None where there is no such input."""
    verified: "VerifiedNetwork | None" = None
    """Keeps the verdicts, if there are any."""
    unlike: set[str] = field(default_factory=set)
    """In which ways clouds were unlike those of the training (:mod:`eitskin_proto.skin.familiar_shape`)."""


def named(
    request: Request,
    labels: str,
    skin: Skin = PAPER,
    touches: TouchKind = "raise",
    conditions: Conditions | None = None,
    noise: "Noise | None" = None,
) -> Named:
    """Return the solver that a request means on phantoms with these labels.

    Args:
        request: Name, reference, bundle.
        labels: ``"units"`` or ``"area"``, what the phantoms' truth means.
        skin: Whose maps and clouds there are.
        touches: What touches the phantoms, see :func:`bundle_for`.
        conditions: The noise that a verifier assumes; None is N2 at 50 dB.
        noise: Noise as measured, instead of that of the conditions.

    Raises:
        ValueError: The name is unknown, the network takes no such reference, or the bundle holds no such network.
        MismatchError: The bundle is for another skin.
    """
    if request.reference is not None and request.reference not in REFERENCES:
        raise ValueError(f"reference {request.reference!r} is unknown; expected one of {', '.join(REFERENCES)}")
    is_fitted = conditions is not None and conditions.cloud == "fitted"
    if is_fitted and request.name in SOLVERS:
        raise ValueError("--cloud fitted needs --solver verified or a network: classical solvers take no fitted shape")
    if request.at_rest and request.name != VERIFIED:
        raise ValueError("--at-rest needs --solver verified")
    if request.name in SOLVERS and not is_deployed(request):
        return Named(Run(SOLVERS[request.name], request.reference or "post"))
    if request.name == VERIFIED:
        return _verified(request, labels, skin, touches, conditions or Conditions(), noise)
    if request.name not in (*NETWORKS, *SOLVERS):
        raise ValueError(f"solver {request.name!r} is unknown; expected one of {', '.join(NAMES)}")
    if is_fitted:
        found = _verified(request, labels, skin, touches, conditions or Conditions(), noise)
        assert found.verified is not None
        return replace(found, run=replace(found.run, solver=found.verified.on_found_shape), verified=None)
    return _network(request, labels, skin, touches)


def usual_solver(bundle: str | Path | None) -> str:
    """Return the solver that is tried where none is named: the network, or the best of a bundle without one.

    Raises:
        BundleError: The bundle cannot be read.
    """
    if bundle is None or (loaded := load_bundle(bundle, lazily=True)).has_network:
        return NETWORK
    return next((name for name in solvers_of(loaded) if name in SOLVERS), NETWORK)


def is_deployed(request: Request) -> bool:
    """Return whether a request means a solver of its bundle: a network, or the operators of a bundle without one.

    Raises:
        BundleError: The bundle cannot be read.
    """
    if request.name not in SOLVERS:
        return True
    if request.bundle is None:
        return False
    bundle = load_bundle(request.bundle, lazily=True)
    return not bundle.has_network and request.name in solvers_of(bundle)


def bundle_for(request: Request, labels: str, touch_kind: TouchKind = "raise") -> "Bundle":
    """Return the bundle that a request names, or the shipped one of some labels and touches.

    Args:
        request: May name a file; then that serves all touches.
        labels: ``"units"`` or ``"area"``.
        touch_kind: Which way touches change conductance. Where no shipped bundle is meant for these, that for touches
            that raise it is taken: what it shows of them is then what there is to say.

    Raises:
        BundleError: It cannot be read.
    """
    from eitskin.model.bundle import default_path

    own = default_path(labels, touch_kind)
    return load_bundle(request.bundle or (own if own.exists() else default_path(labels)))


def bundle_on(request: Request, labels: str, touch_kind: TouchKind, skin: Skin) -> "Bundle | None":
    """Return the bundle of the network, or whose gate judges; None where none is named and none shipped is of a skin.

    Raises:
        MismatchError: The bundle that is named, or the network's, is of another skin.
    """
    bundle = bundle_for(request, labels, touch_kind)
    if request.bundle is None and request.name in SOLVERS and bundle.skin.grid_id != skin.grid_id:
        return None
    hint = "name a bundle of this skin with --bundle, or the skin of this bundle with --skin"
    check_made_for(str(bundle.path), skin, grid_id=bundle.skin.grid_id, skin_digest=bundle.skin.digest, hint=hint)
    return bundle


def _network(request: Request, labels: str, skin: Skin, touches: TouchKind) -> Named:
    from eitskin.model.buffers import Buffers
    from eitskin.model.engine import VD2T_SMALL, engines
    from eitskin.model.geometry import GeometryGraph
    from eitskin.reference.predicted import log_ratio

    loaded = bundle_on(request, labels, touches, skin)
    assert loaded is not None, "a network has a bundle"
    _check_reference(request, str(loaded.path), takes_prediction=loaded.uses_prediction)
    buffers = Buffers(loaded)
    engine = next((one for one in engines(loaded, buffers) if one.name == request.name), None)
    if engine is None:
        how = f"; it has {', '.join(solvers_of(loaded))}"
        if request.name == VD2T_SMALL:
            how = "; 'eitskin pair' puts one in"
        raise ValueError(f"{loaded.path} holds no network {request.name!r}{how}")
    graph = GeometryGraph(loaded)
    prediction = request.prediction if loaded.uses_prediction else None
    unlike: set[str] = set()
    shown: list[Any] = [None, 0]  # the sheet whose geometry is in the buffers, and how many there were

    def solve(case: Case) -> npt.NDArray[np.float64]:
        if shown[0] is not case.sheet:
            predicted = None
            if prediction == "scan":
                predicted = log_ratio(case.sheet.predicted(), flat_voltages(case.sheet.skin))
            shown[:] = [case.sheet, shown[1] + 1]
            unlike.update(unlike_family(np.asarray(case.sheet.cloud_mm, dtype=np.float64), skin))
            buffers.use_geometry(graph.geometry(case.sheet.cloud_mm, predicted, shown[1]))
        buffers.change[0] = relative_change(case.voltages, case.flat_reference)
        engine.infer()
        return np.asarray(buffers.map, dtype=np.float64).reshape(skin.grid.shape)

    solver: Solver = solve
    return Named(Run(solver, "pre"), loaded.id, prediction, unlike=unlike)


def _verified(
    request: Request, labels: str, skin: Skin, touches: TouchKind, conditions: Conditions, noise: "Noise | None"
) -> Named:
    from eitskin_sim.verification.residual import Noise
    from eitskin_tools.evaluation.verified.solver import VerifiedNetwork

    name = usual_solver(request.bundle) if request.name == VERIFIED else request.name
    network = _network(replace(request, name=name), labels, skin, touches)
    assumed = Noise(conditions.noise, conditions.snr_db) if noise is None else noise
    verified = VerifiedNetwork(network.run, assumed, labels, touches, skin, at_rest=request.at_rest)
    return replace(network, run=verified.run, verified=verified)


def verdicts_of(
    phantoms: Sequence[Phantom], by_group: dict[Group, Named], seeds: int
) -> "dict[int, list[MapVerdict]] | None":
    """Return the verdicts on every phantom, one a seed, by its ``id``; None where the solver gives none."""
    if any(one.verified is None for one in by_group.values()):
        return None
    found: dict[int, list[MapVerdict]] = {}
    for key, one in by_group.items():
        assert one.verified is not None
        group = [phantom for phantom in phantoms if (phantom.truth, phantom.scene.touch_kind) == key]
        for number, phantom in enumerate(group):
            found[id(phantom)] = list(one.verified.checked[number * seeds : (number + 1) * seeds])
    return found


def _check_reference(request: Request, path: str, *, takes_prediction: bool) -> None:
    """A network's dV is against the flat sheet; V_pred only comes on top of it."""
    if request.reference == "post":
        raise ValueError(
            f"{request.name} takes the reference before the deformation, by design; found --reference post: say "
            "--reference pre"
        )
    if request.reference == "predicted" and not (takes_prediction and request.prediction == "scan"):
        why = "its head has no V_pred input" if not takes_prediction else f"--prediction is {request.prediction}"
        raise ValueError(f"{request.name} of {path} cannot use --reference predicted: {why}; say --reference pre")
    if request.prediction != "scan" and not takes_prediction:
        raise ValueError(f"{path} has no V_pred input; leave --prediction {request.prediction} out")


def evaluate_requests(
    phantoms: Sequence[Phantom],
    requests: Sequence[Request],
    conditions: Conditions,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Return the report of each request, all on the same data, networks with the bundle of each phantom's kind.

    Args:
        phantoms: What to look at.
        requests: Solvers.
        conditions: Noise, seeds, shifts.
        progress: Called with the phantoms done and all phantoms.

    Raises:
        ValueError: A request cannot be met.
    """
    found = []
    for request, (by_group, results) in zip(
        requests, evaluate_named(phantoms, requests, conditions, progress), strict=True
    ):
        head = _head(request, conditions, by_group.values())
        found.append({**report(request.name, conditions.noise, results), **head})
        if (checked := verdicts_of(phantoms, by_group, conditions.seeds)) is not None:
            from eitskin_tools.evaluation.verified.solver import add_verdicts

            add_verdicts(found[-1], results, checked)
    return found


def evaluate_named(
    phantoms: Sequence[Phantom],
    requests: Sequence[Request],
    conditions: Conditions,
    progress: Progress | None = None,
) -> list[tuple[dict[Group, Named], Results]]:
    """Return, for each request, its solvers by what the phantoms are like, and its scores in the phantoms' order."""
    groups: dict[Group, list[Phantom]] = {}
    for one in phantoms:
        groups.setdefault((one.truth, one.scene.touch_kind), []).append(one)
    solvers = [
        {(labels, touches): named(request, labels, conditions.skin, touches, conditions) for labels, touches in groups}
        for request in requests
    ]
    results: list[Results] = [[] for _ in requests]
    order = {id(one): index for index, one in enumerate(phantoms)}
    done = 0

    def step(now: int, _: int) -> None:
        if progress is not None:
            progress(done + now, len(phantoms))

    for key, group in groups.items():
        runs, numbers = [one[key].run for one in solvers], [order[id(one)] for one in group]
        found = evaluate_all(group, runs, conditions, step, numbers)
        for kept, scores in zip(results, found, strict=True):
            kept.extend(scores)
        done += len(group)
    ordered = [sorted(kept, key=lambda pair: order[id(pair[0])]) for kept in results]
    return list(zip(solvers, ordered, strict=True))


Array = npt.NDArray[np.float64]


def judge_of(bundle: Bundle | None) -> Callable[[Array, Array], bool]:
    """Return what judges (104,) V against a reference (104,) V; without a gate every frame is taken for touched."""
    arrays = None if bundle is None else bundle.gate_arrays()
    if arrays is None:
        return lambda volts, reference: True
    gate = Gate(arrays)

    def touched(volts: Array, reference: Array) -> bool:
        gate.change[:] = relative_change(volts, reference)
        return gate.touched()

    return touched


def touched_trial(
    phantoms: list[Phantom], each: int, request: Request, conditions: Conditions, progress: Progress | None
) -> dict[str, Any]:
    """Return the summary of one solver on drawn phantoms, ``each`` of them at a deformation."""
    ((solvers, results),) = evaluate_named(phantoms, [request], conditions, progress)
    found = {**_head(request, conditions, solvers.values()), **summary(results, each, conditions.skin.grid)}
    if (checked := verdicts_of(phantoms, solvers, conditions.seeds)) is not None:
        from eitskin_tools.evaluation.verified.solver import summary_of

        found["verified"] = summary_of([(phantom, scores, checked[id(phantom)]) for phantom, scores in results])
        found["flagged"] = found["verified"]["flagged"]
    return found


def untouched_trial(
    deformations: int,
    family: Any,
    labels: trials.Labels,
    request: Request,
    conditions: Conditions,
    seed: int,
    progress: Progress | None,
) -> dict[str, Any]:
    """Return how high the maps of bent sheets rise that nothing touches, of the network for the skin's touches."""
    touches: TouchKind = "lower" if conditions.skin.touch_kind == "lower" else "raise"
    solver = named(request, labels, conditions.skin, touches, conditions)
    peaks: list[float] = []

    def solve(case: Case) -> npt.NDArray[np.float64]:
        image = solver.run.solver(case)
        peaks.append(float(image.max()))
        return image

    run = Run(solve, solver.run.reference)
    evaluate_all(trials.untouched(deformations, family, labels, conditions.skin, seed), [run], conditions, progress)
    found = np.array(peaks)
    return {
        **_head(request, conditions, [solver]),
        "maps": len(found),
        "peak": float(found.max()),
        "peak_mean": float(found.mean()),
        "ghost_share": float(np.mean(found >= TOUCHED)),
        "worst_deformation": int(np.argmax(found)) // conditions.seeds,
    }


def _head(request: Request, conditions: Conditions, solvers: Collection[Named]) -> dict[str, Any]:
    first = next(iter(solvers))
    return {
        "solver": request.name,
        "noise": conditions.noise,
        "snr_db": conditions.snr_db,
        "seeds": conditions.seeds,
        "shift_px": conditions.shift_px,
        "cloud": conditions.cloud,
        "reference": first.run.reference,
        "prediction": first.prediction,
        "bundles": sorted({one.bundle_id for one in solvers if one.bundle_id}),
        "skin_digest": conditions.skin.digest,
        "unlike_training": sorted(set[str]().union(*(one.unlike for one in solvers))),
    }
