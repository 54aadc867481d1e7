"""Ways to compute the same map from the same bundle, side by side, each a function without arguments.

::

    vd2t, vd2t-int8, tikhonov       the deployed engines: geometry folded to a bias, one thread
    with-gentle                     the stream's own engine with its network for faint touches: the most a frame takes
    unsplit                         both graphs joined: geometry evaluated a frame, one thread
    onnxruntime-default             the same with ONNX Runtime's default session and its threads
    torch-eager                     the whole network as PyTorch runs it, one thread
    bandwidth, bandwidth-int8       one pass over as many bytes as the head has, in float32 or int8: the floor

A variant that cannot be had (torch is missing, the bundle carries no architecture) is left out, with the reason.
"""

import io
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.model.buffers import Buffers, Engine
from eitskin.model.bundle import Bundle
from eitskin.model.engine import HEADS, default_solver, engines, longest
from eitskin.model.gentle import GentleEngine
from eitskin.model.geometry import GeometryGraph
from eitskin.model.manifest import GENTLE
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.cloud import network_input

Infer = Callable[[], object]

FLOORS: Final = {"bandwidth": "vd2t", "bandwidth-int8": "vd2t-int8"}
"""Which head's bytes each floor reads."""


def variants(bundle: Bundle, seed: int = 0) -> tuple[dict[str, Infer], dict[str, str]]:
    """Return the variants by name, ours first, and why others are missing.

    Args:
        bundle: What is deployed.
        seed: Of the dV that every variant gets.
    """
    buffers = Buffers(bundle)
    buffers.take(GeometryGraph(bundle).geometry(None, None, 0))
    buffers.change[:] = 0.1 * np.random.default_rng(seed).standard_normal((1, N_ROWS))
    deployed = {engine.name: engine for engine in engines(bundle, buffers)}
    found: dict[str, Infer] = {name: _own(engine).infer for name, engine in deployed.items()}
    if GENTLE in bundle.beside:
        found["with-gentle"] = longest(deployed[default_solver(bundle)])
    missing: dict[str, str] = {}
    builders: dict[str, Callable[[], Infer]] = {
        "unsplit": lambda: _unsplit(bundle, buffers, threads=1),
        "onnxruntime-default": lambda: _unsplit(bundle, buffers, threads=0),
        "torch-eager": lambda: _torch(bundle, buffers),
    }
    for name, build in builders.items():
        try:
            found[name] = build()
        except (ImportError, KeyError, TypeError, ValueError) as error:
            missing[name] = f"{type(error).__name__}: {error}"
    for name, solver in FLOORS.items():
        if solver in found:
            found[name] = _bandwidth(streamed_bytes(bundle, solver))
    return found, missing


def _own(engine: Engine) -> Engine:
    """Return the one network that a frame with a firm touch takes."""
    return engine.own if isinstance(engine, GentleEngine) else engine


def streamed_bytes(bundle: Bundle, solver: str = "vd2t") -> int:
    """Return how many bytes of weights a head reads a frame: its file, which is weights but for a few kB."""
    return len(bundle.files[HEADS[solver]])


def _unsplit(bundle: Bundle, buffers: Buffers, threads: int) -> Infer:
    import onnx

    from eitskin.model.session import onnxruntime

    geometry, head = (onnx.load(io.BytesIO(bundle.files[name])) for name in ("geometry.onnx", "head.onnx"))
    joined = onnx.compose.merge_models(
        onnx.compose.add_prefix(geometry, "geometry_"), onnx.compose.add_prefix(head, "head_"),
        io_map=[("geometry_bias", "head_bias")],
    )  # fmt: skip
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    if threads:
        options.intra_op_num_threads = options.inter_op_num_threads = threads
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(joined.SerializeToString(), options, providers=["CPUExecutionProvider"])
    feed = {"geometry_cloud": _flat(bundle), "head_dv": buffers.change}
    if bundle.uses_prediction:
        feed["head_log_predicted"] = buffers.log_predicted
    return lambda: session.run(None, feed)


def _flat(bundle: Bundle) -> npt.NDArray[np.float32]:
    """Return the (1, 3, rows, columns) input of the flat sheet."""
    grid = bundle.skin.grid
    return network_input(grid.flat_cloud_mm(), grid)[np.newaxis]


def _torch(bundle: Bundle, buffers: Buffers) -> Infer:
    import torch

    from eitskin_training.network.model import VD2T
    from eitskin_training.recipes import Recipe

    architecture = Recipe.from_dict(bundle.manifest["recipe"]).architecture
    model = VD2T(architecture, bundle.skin).eval()  # its weights' values cost no time
    torch.set_num_threads(1)
    dv = torch.from_numpy(buffers.change)
    cloud = torch.from_numpy(_flat(bundle))
    predicted = torch.from_numpy(buffers.log_predicted) if bundle.uses_prediction else None

    def infer() -> Any:
        with torch.inference_mode():
            return model(dv, cloud, None, predicted)  # a tensor

    return infer


def _bandwidth(size: int) -> Infer:
    """Read ``size`` bytes as a matrix in one product with a vector, BLAS on one thread."""
    columns = 512
    matrix: npt.NDArray[np.float32] = np.ones((max(1, size // (4 * columns)), columns), dtype=np.float32)
    vector = np.ones(columns, dtype=np.float32)
    out = np.empty(len(matrix), dtype=np.float32)
    return lambda: np.matmul(matrix, vector, out=out)
