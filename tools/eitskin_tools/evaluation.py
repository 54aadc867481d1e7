"""The network as one more solver of the harness, and the table that stands beside the paper's.

The network runs through the deployed engine: the bundle's own graphs, the runtime's normalisation, the reference
taken flat and untouched. It takes the shipped bundle whose labels match the phantoms, unless one is named.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.grid import GRID_SHAPE
from eitskin_proto.normalise import relative_change
from eitskin_sim.evaluate import SOLVERS, Case, Solver, evaluate, report
from eitskin_sim.noise import Kind
from eitskin_sim.parts import Phantom
from eitskin_sim.predict import flat_voltages

PAPER_CC: Final[dict[str, tuple[float, ...]]] = {
    "tikhonov": (0.5967, 0.7198, 0.6387, 0.6565, 0.7641, 0.6659, 0.7036, 0.5551),
    "l1": (0.5755, 0.6080, 0.6700, 0.6484, 0.7118, 0.7010, 0.7395, 0.6665),
    "sbl": (0.6877, 0.7110, 0.7408, 0.8132, 0.8020, 0.7085, 0.8152, 0.6549),
    "vd2t": (0.9976, 0.9762, 0.9957, 0.9999, 0.9987, 0.9660, 0.9974, 0.9981),
}
"""Correlation coefficients of the paper's Table II, phantoms 1 to 8."""

NETWORKS: Final = ("vd2t", "vd2t-int8")
"""Solvers that a bundle provides."""

NAMES: Final = (*SOLVERS, *NETWORKS)
"""Every name that ``eitskin evaluate --solver`` takes."""


def solver_named(name: str, labels: str, bundle: str | Path | None = None) -> tuple[Solver, str | None]:
    """Return a solver, and the id of the bundle behind it if there is one.

    Args:
        name: One of ``NAMES``.
        labels: ``"units"`` or ``"area"``, what the phantoms' truth means.
        bundle: A bundle's file; None takes the shipped one for these labels.

    Raises:
        ValueError: The name is unknown, or the bundle holds no such network.
    """
    if name in SOLVERS:
        return SOLVERS[name], None
    if name not in NETWORKS:
        raise ValueError(f"solver {name!r} is unknown; expected one of {', '.join(NAMES)}")
    from eitskin.bundle import default_path, load_bundle
    from eitskin.engine import Buffers, GeometryGraph, engines
    from eitskin.prediction import log_ratio

    loaded = load_bundle(bundle or default_path(labels))
    buffers = Buffers(loaded.bias_width)
    engine = next((one for one in engines(loaded, buffers) if one.name == name), None)
    if engine is None:
        raise ValueError(f"{loaded.path} holds no network {name!r}; export one with 'eitskin export'")
    graph = GeometryGraph(loaded)
    revision = 0

    def solve(case: Case) -> npt.NDArray[np.float64]:
        nonlocal revision
        revision += 1
        predicted = log_ratio(case.sheet.predicted(), flat_voltages()) if loaded.uses_prediction else None
        buffers.take(graph.geometry(case.sheet.cloud_mm, predicted, revision))
        buffers.change[0] = relative_change(case.voltages, case.flat_reference)
        engine.infer()
        return np.asarray(buffers.map, dtype=np.float64).reshape(GRID_SHAPE)

    return solve, loaded.id


def evaluate_named(
    phantoms: Sequence[Phantom],
    name: str,
    *,
    noise: Kind,
    snr_db: float,
    reference: str | None,
    seeds: int,
    bundle: str | Path | None = None,
) -> dict[str, Any]:
    """Return the report of one solver on phantoms, each with the bundle of its own labels.

    Args:
        phantoms: What to look at.
        name: One of ``NAMES``.
        noise: Definition of the noise.
        snr_db: Its level.
        reference: "pre", "post" or "predicted"; None is what the solver is meant for: pre for a network, else post.
        seeds: Noise draws.
        bundle: A bundle's file for all phantoms.

    Raises:
        ValueError: The name or the reference is unknown, or a network is given another reference than pre.
    """
    if name in NETWORKS and reference not in (None, "pre"):
        raise ValueError(f"{name} takes the reference before the deformation; say --reference pre, found {reference!r}")
    kind: Any = reference or ("pre" if name in NETWORKS else "post")
    solvers = {labels: solver_named(name, labels, bundle) for labels in dict.fromkeys(one.truth for one in phantoms)}
    results = []
    for labels, (solve, _) in solvers.items():
        group = [one for one in phantoms if one.truth == labels]
        results += evaluate(group, solve, noise=noise, snr_db=snr_db, reference=kind, seeds=seeds)
    order = {id(one): index for index, one in enumerate(phantoms)}
    results.sort(key=lambda pair: order[id(pair[0])])
    found = report(name, noise, results)
    ids = {identity for _, identity in solvers.values() if identity}
    return {**found, "snr_db": snr_db, "reference": kind, "seeds": seeds, "bundles": sorted(ids)}


def comparison(
    phantoms: Sequence[Phantom], *, noise: Kind, snr_db: float, seeds: int, names: Sequence[str] | None = None
) -> str:
    """Return a Markdown table: CC of each phantom, solvers beside the paper's, then the means with other references.

    Args:
        phantoms: The eight of the paper's Table II, or others (then without the paper's columns).
        noise: Definition of the noise.
        snr_db: Its level.
        seeds: Noise draws.
        names: Solvers; None takes Tikhonov, l1 and SBL on both grids, and the network if its bundle is there.
    """
    chosen = list(names or [n for n in SOLVERS if "-" in n])
    if names is None and _has_bundle(phantoms):
        chosen.append("vd2t")
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for name in chosen:
        for kind in ("pre",) if name in NETWORKS else ("post", "pre", "predicted"):
            found[name, kind] = evaluate_named(phantoms, name, noise=noise, snr_db=snr_db, reference=kind, seeds=seeds)
    own = {name: found[name, "pre" if name in NETWORKS else "post"] for name in chosen}
    papers = list(PAPER_CC) if len(phantoms) == len(PAPER_CC["l1"]) else []
    lines = [
        f"CC, {noise} at {snr_db:g} dB, {seeds} noise draw(s); classical solvers with the post-deformation reference.",
        "",
    ]
    rows = [
        [phantom.name, *(_text(own[n]["phantoms"][i]["cc"]) for n in chosen), *(_text(PAPER_CC[p][i]) for p in papers)]
        for i, phantom in enumerate(phantoms)
    ]
    paper_means = [_text(float(np.mean(PAPER_CC[p]))) for p in papers]
    rows.append(["mean", *(_text(own[n]["mean"]["cc"]) for n in chosen), *paper_means])
    lines += _table(["phantom", *chosen, *(f"paper: {p}" for p in papers)], rows)
    lines += ["", "Means by reference.", ""]
    header = ["solver", "reference", "CC", "PSNR dB", "RIE", "localisation mm", "exact"]
    measures = ("cc", "psnr_db", "rie", "localisation_mm", "exact")
    rows = [[name, kind, *(_text(one["mean"][m]) for m in measures)] for (name, kind), one in found.items()]
    return "\n".join(lines + _table(header, rows))


def _has_bundle(phantoms: Sequence[Phantom]) -> bool:
    from eitskin.bundle import default_path

    return all(default_path(phantom.truth).exists() for phantom in phantoms)


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *(f"| {' | '.join(row)} |" for row in rows)]
