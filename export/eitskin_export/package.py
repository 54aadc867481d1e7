"""From a training run to a bundle: fold, export, compare, quantise, audit the gate, score, write.

Nothing is fitted here. The gate is the run's own (:mod:`eitskin_training.gate.stored`); for a run without a gate,
training fits one.
"""

import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import onnx

from eitskin.pipeline.frame_pipeline import STRONG_VALUE
from eitskin_export import consistency, graphs, parity
from eitskin_export.bundle import projection_bytes, write
from eitskin_export.fold import split
from eitskin_proto.skin.cloud import network_input
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import Skin
from eitskin_sim.fem.jacobian import flat_jacobian
from eitskin_training.gate import material
from eitskin_training.gate.fit import Gate
from eitskin_training.gate.stored import GiveBends, gate_of_run
from eitskin_training.run_files import Trained
from eitskin_training.samples.batches import TrainingData, noisy_change

import eitskin.model.session  # noqa: F401 -- before the next line: it sends no telemetry  # isort: skip
from onnxruntime.quantization import QuantType, quantize_dynamic  # isort: skip

from eitskin_export.graphs import check, quiet
from eitskin_sim.measurement.noise import NOISES, Kind
from eitskin_sim.solvers.tikhonov import tikhonov_matrix, weighed
from eitskin_training.network.model import VD2T
from eitskin_training.score import score

MOST_SCORED: Final = 2000
"""Samples of each entry of a card, at most."""


def card(model: VD2T, data: TrainingData) -> dict[str, Any]:
    """Return scores on the held-out bends: {family: {noise: {loss, cc, worst_bend_cc, untouched_peak, samples}}}.

    Args:
        model: A trained network.
        data: Its data set.
    """
    return {
        family: {kind: _entry(model, data, rows, kind) for kind in NOISES} for family, rows in data.held_out.items()
    }


def _entry(model: VD2T, data: TrainingData, rows: Any, kind: Kind) -> dict[str, float | int]:
    found = score(model, data, rows, (kind,), most=MOST_SCORED)
    return {
        "loss": round(found.loss, 6),
        "cc": round(found.cc, 5),
        "worst_bend_cc": round(found.worst_bend_cc, 5),
        "untouched_peak": round(found.untouched_peak, 4),
        "samples": min(MOST_SCORED, len(rows)),
    }


TIKHONOV_FACTOR: Final = 1e-3
"""Tikhonov's factor (paper section V.B), relative to the largest eigenvalue of J J^T."""


def first_product(graph: bytes) -> str:
    """Return the name of the first matrix product in a graph."""
    model = onnx.load_from_string(graph)
    return next(str(node.name) for node in model.graph.node if node.op_type in {"Gemm", "MatMul"})


def int8_head(graph: bytes) -> bytes:
    """Return a head with dynamically quantised layers, all but the first."""
    first = first_product(graph)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "head.onnx", Path(folder) / "int8.onnx"
        model = onnx.load_from_string(graph)
        del model.graph.value_info[:]  # the shapes of transposed weights, which quantising turns round
        onnx.save_model(model, source)
        with quiet():
            quantize_dynamic(
                source,
                target,
                weight_type=QuantType.QInt8,
                per_channel=True,
                op_types_to_quantize=["MatMul", "Gemm"],
                nodes_to_exclude=[first, f"{first}_MatMul"],  # the quantiser renames a Gemm before it looks
            )
        model = onnx.load(target)
        check(model)
    original = onnx.load_from_string(graph)
    onnx.helper.set_model_props(model, {item.key: item.value for item in original.metadata_props})
    return bytes(model.SerializeToString())


MIN_STRONG_TOUCH_MM2: Final = 100.0
"""10 mm square: the least that counts as a strong touch, however quiet the network is."""

AUDITED_FRAMES: Final = 400
"""With the cloud of the flat sheet and no prediction."""

GHOST_MARGIN: Final = 2
"""Times the largest ghost."""


def audit_pixels(
    geometry: bytes, head: bytes, bends: npt.NDArray[np.float64], reference: npt.NDArray[np.float64], grid: Grid
) -> int:
    """Return how many pixels above one half make a strong touch.

    Args:
        geometry: The geometry graph.
        head: The head.
        bends: (n, 104) log(V / V0) of untouched sheets that nothing learned from.
        reference: (104,) V0.
        grid: Of the map.
    """
    rng = np.random.default_rng(0xA0D17)
    dv = material.noisy_change(bends[rng.integers(len(bends), size=AUDITED_FRAMES)], reference, rng).astype(np.float32)
    flat = np.repeat(network_input(grid.flat_cloud_mm(), grid)[np.newaxis], AUDITED_FRAMES, axis=0)
    maps = parity.run_graphs(geometry, head, dv, flat, np.zeros_like(dv))["map"]
    largest = int(np.count_nonzero(maps > STRONG_VALUE, axis=1).max())
    return min(max(round(MIN_STRONG_TOUCH_MM2 / grid.pixel_mm2), 1, GHOST_MARGIN * largest), grid.n_pixels)


def export(
    found: Trained,
    data: TrainingData,
    out: Path,
    *,
    tell: Callable[[str], None] = lambda _: None,
    jacobian: Callable[[Skin], npt.NDArray[np.float64]] = flat_jacobian,
    bends: GiveBends | None = None,
) -> dict[str, Any]:
    """Write a bundle and return its report: id, bytes, parity, int8 error, gate, metrics.

    Args:
        found: The network.
        data: Its data set, which the gate learns from and the metrics are measured on.
        out: The bundle's path.
        tell: Called with each step.
        jacobian: Gives the (104, pixels) relative Jacobian of the projection.
        bends: Gives the untouched sheets for a gate that must be fitted; None solves them.

    Raises:
        SkinError: The graphs differ from the network, or still hold a training layer.
    """
    skin = found.skin
    tell("exporting the two graphs")
    geometry, head = split(found.model)
    geometry_bytes, head_bytes = graphs.geometry_graph(geometry), graphs.head_graph(head)
    differences = parity.parity(found.model, geometry_bytes, head_bytes)
    tell("quantising")
    int8_bytes = int8_head(head_bytes)
    int8 = parity.int8_error(geometry_bytes, head_bytes, int8_bytes, *held_out_inputs(data))
    own = gate_of_run(found.folder, data, found.seed, tell=tell, bends=bends)
    tell("auditing the gate")
    touch_gate = own.gate.audited(
        audit_pixels(geometry_bytes, head_bytes, own.bends.measure, data.reference, skin.grid)
    )
    tell("measuring what healthy frames look like")
    relative = jacobian(skin)
    inverse = np.asarray(np.linalg.inv(weighed(relative, TIKHONOV_FACTOR, 0.0)[2]))
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
        "tikhonov.npy": projection_bytes(tikhonov_matrix(relative, TIKHONOV_FACTOR, 0.0), skin.grid),
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


def held_out_inputs(data: TrainingData) -> tuple[parity.Array, parity.Array, parity.Array]:
    """Return dv, clouds and log_predicted of 300 samples at bends never trained on, with noise."""
    rows = data.apart
    rng = np.random.default_rng(8)
    rows = rng.choice(rows, size=min(300, len(rows)), replace=False)
    bends = data.deformation[rows]
    return noisy_change(data, rows, NOISES, 50.0, rng), data.clouds[bends], data.log_predicted[bends]


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
