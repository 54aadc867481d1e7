"""From a training run to a bundle: fold, export, compare, quantise, audit the gate, score, write.

Nothing is fitted here. The gate is the run's own (:mod:`eitskin_training.gate.stored`), which training makes up for a
run that has none.
"""

from collections.abc import Callable
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
from eitskin_proto.skin.skin import Skin
from eitskin_sim.fem.jacobian import flat_jacobian
from eitskin_training.card import card
from eitskin_training.gate.fit import Gate
from eitskin_training.gate.stored import GiveBends, gate_of_run
from eitskin_training.run_files import Trained
from eitskin_training.samples.batches import TrainingData, noisy_change


def export(
    found: Trained,
    data: TrainingData,
    out: Path,
    *,
    tell: Callable[[str], None] = lambda _: None,
    jacobian: Callable[[Skin], npt.NDArray[np.float64]] = flat_jacobian,
    bends: GiveBends | None = None,
    gate_steps: int | None = None,
) -> dict[str, Any]:
    """Write a bundle and return what is worth knowing of it: id, bytes, parity, int8 error, gate, metrics.

    Args:
        found: The network.
        data: Its data set, which the gate learns from and the metrics are measured on.
        out: The bundle's path.
        tell: Told what is being done.
        jacobian: Gives the (104, pixels) relative Jacobian of the projection.
        bends: Gives the untouched sheets for a gate that must be made up; None solves them.
        gate_steps: Steps that such a gate is fitted for; None takes the usual ones.

    Raises:
        SkinError: The graphs differ from the network, or still hold a training layer.
    """
    skin = found.skin
    tell("exporting the two graphs")
    geometry, head = split(found.model)
    geometry_bytes, head_bytes = graphs.geometry_graph(geometry), graphs.head_graph(head)
    differences = parity.parity(found.model, geometry_bytes, head_bytes)
    tell("quantising")
    int8_bytes = quantise.int8_head(head_bytes)
    int8 = parity.int8_error(geometry_bytes, head_bytes, int8_bytes, *held_out_inputs(data))
    own = gate_of_run(found.folder, data, found.seed, tell=tell, bends=bends, steps=gate_steps)
    tell("auditing the gate")
    touch_gate = own.gate.audited(
        audit_pixels(geometry_bytes, head_bytes, own.bends.measure, data.reference, skin.grid)
    )
    tell("measuring what healthy frames look like")
    inverse = projection.damped_inverse(jacobian(skin))
    filling = {name: value.numpy() for name, value in found.content.get("filling", {}).items()}
    healthy = consistency.healthy(data, found.recipe, own.bends, inverse, filling)
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
        "tikhonov.npy": projection_bytes(projection.tikhonov(jacobian(skin)), skin.grid),
        "gate.npz": touch_gate.to_npz(),
        "consistency.npz": healthy.to_npz(),
    }
    facts = _facts(found, data, touch_gate, metrics)
    identity = write(out, files, facts, skin)
    tell("running it through the runtime's engine")
    differences = {**differences, "map through the runtime": parity.through_runtime(found.model, out)}
    return {
        "bundle": identity,
        "path": str(out),
        "bytes": out.stat().st_size,
        "labels": found.recipe.labels,
        "touches": data.touch_kind,
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
    tell: Callable[[str], None] = lambda _: None,
    bends: GiveBends | None = None,
    gate_steps: int | None = None,
) -> dict[str, Any]:
    """Fit a bundle's gate once more, leave all else as it is, and return its new id and the gate's facts.

    Args:
        found: The run that the bundle was made from; its stored gate is replaced too.
        data: Its data set.
        path: The bundle; replaced in one rename.
        tell: Told what is being done.
        bends: Gives the untouched sheets for a gate that must be made up; None solves them.
        gate_steps: Steps that such a gate is fitted for; None takes the usual ones.

    Raises:
        MismatchError: The bundle is of another data set.
        SkinError: It is no whole bundle.
    """
    files, facts, skin = read_bundle(path)
    if facts["data_digest"] != data.digest:
        raise MismatchError(
            f"{path}: data set", found=facts["data_digest"], expected=data.digest, hint="name the run it was made from"
        )
    own = gate_of_run(found.folder, data, found.seed, tell=tell, anew=True, bends=bends, steps=gate_steps)
    tell("auditing the gate")
    pixels = audit_pixels(files["geometry.onnx"], files["head.onnx"], own.bends.measure, data.reference, skin.grid)
    touch_gate = own.gate.audited(pixels)
    identity = write(path, {**files, "gate.npz": touch_gate.to_npz()}, {**facts, "gate": touch_gate.facts()}, skin)
    return {"bundle": identity, "path": str(path), "gate": touch_gate.facts()}


def held_out_inputs(data: TrainingData) -> tuple[parity.Array, parity.Array, parity.Array]:
    """Return dv, clouds and log_predicted of 300 samples at bends never trained on, with noise."""
    rows = data.apart
    rng = np.random.default_rng(8)
    rows = rng.choice(rows, size=min(300, len(rows)), replace=False)
    bends = data.deformation[rows]
    return noisy_change(data, rows, ("N1", "N2", "N3"), 50.0, rng), data.clouds[bends], data.log_predicted[bends]


def _facts(found: Trained, data: TrainingData, touch_gate: Gate, metrics: dict[str, Any]) -> dict[str, Any]:
    history = found.content["history"]
    architecture = found.recipe.architecture
    return {
        "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "labels": found.recipe.labels,
        "touches": data.touch_kind,
        "head": {
            "inputs": ["dv", "log_predicted"] if architecture.log_predicted else ["dv"],
            "bias": found.model.bias_width,
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
