"""From a training run to a bundle: fold, export, compare, quantise, fit the gate, score, write."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin_export import consistency, graphs, parity, projection, quantise
from eitskin_export.bundle import projection_bytes, write
from eitskin_export.bundle import read as read_bundle
from eitskin_export.fold import split
from eitskin_export.gate_audit import audit_pixels
from eitskin_proto.errors import MismatchError
from eitskin_training.card import card
from eitskin_training.gate import fit
from eitskin_training.gate.untouched import Bends, solved_bends
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe
from eitskin_training.samples.batches import TrainingData, noisy_change
from eitskin_training.samples.joined import load_all
from eitskin_training.train import network, read


@dataclass(frozen=True, slots=True)
class Trained:
    """What a run's best epoch gives.

    Args:
        model: The network, in evaluation mode.
        recipe: How it was trained.
        content: Everything else in ``best.pt``: seed, data digest, history, ids.
    """

    model: VD2T
    recipe: Recipe
    content: dict[str, Any]


def trained(run: Path) -> Trained:
    """Return the best epoch of a run.

    Raises:
        SkinError: There is none, or it was made for another protocol or grid.
    """
    content = read(run / "best.pt")
    recipe = Recipe.from_dict(content["recipe"])
    return Trained(network(recipe, content["weights"]), recipe, content)


def data_of(found: Trained, directories: Sequence[str] | None = None) -> TrainingData:
    """Return the data set of a run, from where it was or from ``directories``.

    Raises:
        MismatchError: It is another data set.
        OSError: It is gone.
    """
    known: str | list[str] = found.content["data"]  # a run of one data set used to keep its folder alone
    data = load_all(directories or ([known] if isinstance(known, str) else known))
    if data.digest != found.content["data_digest"]:
        raise MismatchError(
            "data set of the run: digest",
            found=data.digest,
            expected=found.content["data_digest"],
            hint="name the one it was trained on with --data",
        )
    data.require(found.recipe)
    return data


def export(
    found: Trained,
    data: TrainingData,
    out: Path,
    *,
    tell: Callable[[str], None] = lambda _: None,
    jacobian: Callable[[], npt.NDArray[np.float64]] = projection.flat_jacobian,
    bends: Callable[[TrainingData], Bends] = solved_bends,
    gate_steps: int = fit.STEPS,
) -> dict[str, Any]:
    """Write a bundle and return what is worth knowing of it: id, bytes, parity, int8 error, gate, metrics.

    Args:
        found: The network.
        data: Its data set, which the gate learns from and the metrics are measured on.
        out: The bundle's path.
        tell: Told what is being done.
        jacobian: Gives the (104, 1350) relative Jacobian of the projection.
        bends: Gives the untouched sheets that the gate learns from.
        gate_steps: Steps that the gate is fitted for.

    Raises:
        SkinError: The graphs differ from the network, or still hold a training layer.
    """
    tell("exporting the two graphs")
    geometry, head = split(found.model)
    geometry_bytes, head_bytes = graphs.geometry_graph(geometry), graphs.head_graph(head)
    differences = parity.parity(found.model, geometry_bytes, head_bytes)
    tell("quantising")
    int8_bytes = quantise.int8_head(head_bytes)
    int8 = parity.int8_error(geometry_bytes, head_bytes, int8_bytes, *held_out_inputs(data))
    tell("fitting the gate")
    untouched = bends(data)
    touch_gate = fit.fit(data, untouched, seed=int(found.content["seed"]), steps=gate_steps).audited(
        audit_pixels(geometry_bytes, head_bytes, untouched.measure, data.reference)
    )
    tell("learning what healthy frames look like")
    inverse = projection.damped_inverse(jacobian())
    filling = {name: value.numpy() for name, value in found.content.get("filling", {}).items()}
    healthy = consistency.healthy(data, found.recipe, untouched, inverse, filling)
    tell("scoring on held-out bends")
    metrics = {
        "held_out": card(found.model, data),
        "parity": differences,
        "int8": int8,
        "electrodes": {**healthy.facts(), "adapted": found.content.get("adapted")},
        "parameters": found.model.parameter_count(),
        "streamed_weights": found.model.streamed_weights(),
    }
    files = {
        "geometry.onnx": geometry_bytes,
        "head.onnx": head_bytes,
        "head_int8.onnx": int8_bytes,
        "tikhonov.npy": projection_bytes(projection.tikhonov(jacobian())),
        "gate.npz": touch_gate.to_npz(),
        "consistency.npz": healthy.to_npz(),
    }
    facts = _facts(found, data, touch_gate, metrics)
    identity = write(out, files, facts)
    tell("running it through the runtime's engine")
    differences = {**differences, "map through the runtime": parity.through_runtime(found.model, out)}
    return {
        "bundle": identity,
        "path": str(out),
        "bytes": out.stat().st_size,
        "labels": found.recipe.labels,
        "parity": differences,
        "int8": int8,
        "gate": touch_gate.facts(),
        "held_out": metrics["held_out"],
    }


def refit_gate(
    found: Trained,
    data: TrainingData,
    path: Path,
    *,
    bends: Callable[[TrainingData], Bends] = solved_bends,
    gate_steps: int = fit.STEPS,
) -> dict[str, Any]:
    """Fit a bundle's gate once more, leave all else as it is, and return its new id and the gate's facts.

    Args:
        found: The bundle's network, for its seed.
        data: Its data set.
        path: The bundle; replaced in one rename.
        bends: Gives the untouched sheets that the gate learns from.
        gate_steps: Steps that the gate is fitted for.

    Raises:
        MismatchError: The bundle is of another data set.
        SkinError: It is no whole bundle.
    """
    files, facts = read_bundle(path)
    if facts["data_digest"] != data.digest:
        raise MismatchError(
            f"{path}: data set", found=facts["data_digest"], expected=data.digest, hint="name the run it was made from"
        )
    untouched = bends(data)
    touch_gate = fit.fit(data, untouched, seed=int(found.content["seed"]), steps=gate_steps).audited(
        audit_pixels(files["geometry.onnx"], files["head.onnx"], untouched.measure, data.reference)
    )
    identity = write(path, {**files, "gate.npz": touch_gate.to_npz()}, {**facts, "gate": touch_gate.facts()})
    return {"bundle": identity, "path": str(path), "gate": touch_gate.facts()}


def held_out_inputs(data: TrainingData, count: int = 300) -> tuple[parity.Array, parity.Array, parity.Array]:
    """Return dv, clouds and log_predicted of samples at bends never trained on, with noise."""
    rows = np.concatenate(list(data.held_out.values())) if data.held_out else data.validation
    rng = np.random.default_rng(8)
    rows = rng.choice(rows, size=min(count, len(rows)), replace=False)
    bends = data.deformation[rows]
    return noisy_change(data, rows, ("N1", "N2", "N3"), 50.0, rng), data.clouds[bends], data.log_predicted[bends]


def _facts(found: Trained, data: TrainingData, touch_gate: fit.Gate, metrics: dict[str, Any]) -> dict[str, Any]:
    history = found.content["history"]
    architecture = found.recipe.architecture
    return {
        "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "labels": found.recipe.labels,
        "head": {
            "inputs": ["dv", "log_predicted"] if architecture.log_predicted else ["dv"],
            "bias": architecture.bias_width,
            "precision": ["fp32", "int8"],
        },
        "gate": touch_gate.facts(),
        "recipe": found.recipe.as_dict(),
        "seeds": {"training": found.content["seed"], "data": data.seed},
        "data_digest": data.digest,
        "training": {
            "epochs": len(history),
            "seconds": round(sum(epoch["seconds"] for epoch in history), 1),
            "best": history[-1],
            "started_from": found.content.get("started_from"),
        },
        "metrics": metrics,
    }
