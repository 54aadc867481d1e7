"""``eitskin bench frame``: a frame's time from the wire to the subscriber, and other ways to infer the same map.

One run measures both. The stream runs a virtual skin, the runtime and a subscriber as processes, at 200 and at 1000
frames/s; before and behind each, :mod:`eitskin_tools.bench.line_floor` measures the same line and socket with no work
in between. The inference calls every way of :func:`variants` in turn, first one call every 5 ms, when caches and clocks
have cooled as on a robot, then back to back. All figures are percentiles.
"""

import argparse
import io
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.model.buffers import Buffers, Engine
from eitskin.model.bundle import Bundle, load_bundle
from eitskin.model.engine import default_solver, engines, longest
from eitskin.model.gentle import GentleEngine
from eitskin.model.geometry import GeometryGraph
from eitskin.model.manifest import GENTLE
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.cloud import network_input
from eitskin_tools.bench.harness import machine, paced, row_text, say
from eitskin_tools.bench.line_floor import floor_ns
from eitskin_tools.command_line import files
from eitskin_tools.demo.score import percentiles_us, timing
from eitskin_tools.demo.show import Options
from eitskin_tools.demo.show import stream as streamed
from eitskin_tools.errors import UsageError

Infer = Callable[[], object]

RATES_HZ: Final = (200.0, 1000.0)
"""Paced rates; the first one is the summary's."""

WARM_CALLS: Final = 30
"""Calls of one variant back to back, before the next has its turn."""


LINE_FRAMES: Final = 1000
"""Most frames of the bare line, before a stream and behind it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--frames", type=int, default=20_000, metavar="N", help="frames at each rate (default 20000)")
    parser.add_argument("--calls", type=int, default=500, metavar="N", help="paced calls of each variant (default 500)")
    parser.add_argument("--bundle", type=files.bundle, metavar="FILE", help="bundle to run (default: the shipped one)")
    parser.add_argument(
        "--rate",
        type=float,
        action="append",
        metavar="HZ",
        help="frames a second (default: 200 and 1000); may be repeated",
    )
    parser.add_argument("--solver", metavar="NAME", help="most accurate solver of the stream, as for 'eitskin run'")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.frames < 100 or arguments.calls < 10:
        raise UsageError("--frames must be at least 100 and --calls at least 10: percentiles need values")
    rates = arguments.rate or RATES_HZ
    streams = {f"{rate:g}": stream(rate, arguments.frames, arguments.bundle, solver=arguments.solver) for rate in rates}
    first = next(iter(streams.values()))
    found = {**first, "streams": streams, **inference(arguments.bundle, arguments.calls), "machine": machine()}
    if arguments.json:
        print(json.dumps(found))
        return 0
    for rate, one in streams.items():
        spans = {key: one[key]["p50"] for key in ("latency_us", "latency_inferred_us", "line_us") if one[key]}
        print(row_text({"what": f"{rate} frames/s, p50", "frames": one["frames"], "lost": one["lost"], **spans}))
        print(
            row_text({"what": "  stages, p50 us", **{name: us["p50"] for name, us in one["stages_us"].items() if us}})
        )
    for name, times in found["inference_us"].items():
        spans = {kind: us["p50"] for kind, us in times.items()}
        print(row_text({"what": f"{name}, p50 us", **spans, "times_ours": found["ratios"][name]}))
    for name, reason in found["missing"].items():
        print(f"{name} was left out: {reason}")
    return 0


def stream(
    rate_hz: float,
    frames: int,
    bundle: Path | None,
    *,
    solver: str | None = None,
) -> dict[str, Any]:
    """Return the timing of a stream at one rate, and of the bare line before and behind it.

    Args:
        rate_hz: Frames a second.
        frames: How many.
        bundle: To run; None for the shipped one.
        solver: The most accurate one to use; None for the bundle's own choice.
    """
    say("frame", f"{frames} frames at {rate_hz:g} frames/s")
    bare = [floor_ns(rate_hz, min(frames, LINE_FRAMES))]
    seconds = frames / rate_hz
    result = streamed(Options(seconds, rate_hz, bundle, solver, clouds=False))
    bare.append(floor_ns(rate_hz, min(frames, LINE_FRAMES)))
    names = ("cpu_us_per_frame", "behind_us", "left_us", "skipped", "solvers", "withheld")
    runtime = {name: result.runtime.get(name) for name in names}
    found = timing(result.record, result.wire_ns)
    line = percentiles_us(np.concatenate(bare))
    over = {name: round(found["latency_us"][name] - line[name], 1) for name in ("p50", "p99")}
    return {**found, "runtime": runtime, "line_us": line, "over_line_us": over}


def inference(path: Path | None, calls: int) -> dict[str, Any]:
    """Return the time of every variant and how many times slower than ours it is.

    Args:
        path: Of the bundle; None for the shipped one.
        calls: Paced calls of each variant.
    """
    bundle = load_bundle(path)
    ways, missing = variants(bundle)
    say("frame", f"{', '.join(ways)}, {calls} paced calls each")
    for infer in ways.values():
        infer()
    spans = paced(ways, calls)
    warm: dict[str, list[int]] = {name: [] for name in ways}
    cpu: dict[str, list[int]] = {name: [] for name in ways}
    for _ in range(max(calls // WARM_CALLS, 1)):
        for name, infer in ways.items():
            for call in range(WARM_CALLS):
                before, start = time.process_time_ns(), time.perf_counter_ns()
                infer()
                end, after = time.perf_counter_ns(), time.process_time_ns()
                if call >= WARM_CALLS // 3:  # the first calls bring the weights back into the caches
                    warm[name].append(end - start)
                    cpu[name].append(after - before)
    times = {
        name: {
            "paced": percentiles_us(spans[name]),
            "warm": percentiles_us(np.array(warm[name])),
            "warm_cpu": percentiles_us(np.array(cpu[name])),
        }
        for name in ways
    }
    ours = next(iter(ways))
    return {
        "ours": ours,
        "inference_us": times,
        "ratios": {name: round(times[name]["paced"]["p50"] / times[ours]["paced"]["p50"], 2) for name in ways},
        "ratios_warm": {name: round(times[name]["warm"]["p50"] / times[ours]["warm"]["p50"], 2) for name in ways},
        "missing": missing,
        "bundle": bundle.id,
    }


def variants(bundle: Bundle, seed: int = 0) -> tuple[dict[str, Infer], dict[str, str]]:
    """Return ways to compute the same map by name, ours first, and why others are missing.

    ::

        vd2t, vd2t-int8, tikhonov       the deployed engines: geometry folded to a bias, one thread
        with-gentle                     with the additional network for faint touches: the longest time of a frame
        unsplit                         both graphs joined: geometry evaluated a frame, one thread
        onnxruntime-default             the same with ONNX Runtime's default session and its threads
        torch-eager                     the whole network as PyTorch runs it, one thread

    A variant that cannot be had (torch is missing, the bundle carries no architecture) is left out, with the reason.

    Args:
        bundle: What is deployed.
        seed: Of the dV that every variant gets.
    """
    buffers = Buffers(bundle)
    buffers.use_geometry(GeometryGraph(bundle).geometry(None, None, 0))
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
    return found, missing


def _own(engine: Engine) -> Engine:
    """Return the one network that a frame with a firm touch takes."""
    return engine.own if isinstance(engine, GentleEngine) else engine


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
