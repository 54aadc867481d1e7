"""The same input twice: in one session, in another process, in a batch, with two threads. Bit-equal, or how far apart.

A sum's order changes its last bits. ONNX Runtime's one-thread session does the same operations in the same order every
time, so runs are bit-equal; a batch or a second thread may cut the sums otherwise. ``python -m
eitskin_tools.bench.stability.sweeps.repeat BUNDLE < inputs`` prints the digest of a process's own maps, for the
comparison.
"""

import hashlib
import subprocess
import sys
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.model.buffers import Buffers
from eitskin.model.bundle import Bundle, load_bundle
from eitskin.model.engine import engines
from eitskin.model.geometry import GeometryGraph
from eitskin.model.session import onnxruntime, session_options
from eitskin_proto.sensor.normalise import relative_change
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.solvers.tikhonov import tikhonov_matrix
from eitskin_tools.bench.stability.harness.rows import Row, rounded
from eitskin_tools.bench.stability.harness.samples import Sample

Floats = npt.NDArray[np.float32]

BATCH: Final = 16

SHARED_SCALE: Final = (
    "; int8 activations take one scale from the whole batch, so the runtime infers one frame at a time"
)


def inputs_of(samples: Sequence[Sample]) -> Floats:
    """Return (n, 104) dV of some samples, repeated with small changes up to a batch."""
    base = np.stack([relative_change(s.read, s.flat) for s in samples])
    rng = np.random.default_rng(0)
    more = base[np.arange(BATCH) % len(base)]
    return np.asarray(more + 0.01 * rng.standard_normal(more.shape), dtype=np.float32)


def maps_of(bundle: Bundle, changes: Floats, engine: int = 0) -> Floats:
    """Return (n, 1350) maps on the flat sheet, one at a time through the runtime's engine."""
    buffers = Buffers(bundle)
    found = engines(bundle, buffers)[engine]
    buffers.take(GeometryGraph(bundle).geometry(None, None, 0))
    maps = []
    for change in changes:
        buffers.change[0] = change
        found.infer()
        maps.append(buffers.map[0].copy())
    return np.stack(maps)


def digest(maps: Floats) -> str:
    """Return the SHA-256 of some maps."""
    return hashlib.sha256(np.ascontiguousarray(maps, dtype="<f4").tobytes()).hexdigest()


def repeat_rows(bundle: Bundle, samples: Sequence[Sample]) -> list[Row]:
    """Return a row for each way of repeating."""
    changes = inputs_of(samples)
    first = maps_of(bundle, changes)
    rows = [
        _row("run to run, a new session", "vd2t", first, maps_of(bundle, changes)),
        _row(
            "run to run, another process", "vd2t", first, None, same=_digest_elsewhere(bundle, changes) == digest(first)
        ),
    ]
    files = [name for name in ("head.onnx", "head_int8.onnx") if name in bundle.files]
    for index, name in enumerate(files):
        single = maps_of(bundle, changes, index)
        label = "vd2t" if index == 0 else "vd2t-int8"
        rows.append(_row("one thread, two threads", label, single, _session_maps(bundle, name, changes, threads=2)))
        sweep = f"batch of 1, batch of {BATCH}"
        try:
            rows.append(_row(sweep, label, single, _batch_maps(bundle, name, changes)))
        except (ImportError, UnbatchedError) as error:
            rows.append(_row(sweep, label, single, None, left_out=f"left out: {error}"))
    matrix = tikhonov_matrix(samples[0].sheet.operators("units").relative_jacobian)
    data = changes.astype(np.float64)
    one = np.stack([matrix @ row for row in data])
    rows.append(_row(f"batch of 1, batch of {BATCH}", "tikhonov", one, (matrix @ data.T).T))
    scene = samples[0].scene
    rows.append(_row("run to run", "forward model", solve_scene(scene).voltages, solve_scene(scene).voltages))
    return rows


def _row(
    sweep: str,
    solver: str,
    one: npt.NDArray[Any],
    other: npt.NDArray[Any] | None,
    *,
    same: bool = False,
    left_out: str = "",
) -> Row:
    difference = 0.0 if other is None else float(np.abs(np.asarray(one, float) - np.asarray(other, float)).max())
    equal = same if other is None else bool(np.array_equal(one, other))
    size = float(np.abs(one).max())
    aside = SHARED_SCALE if solver == "vd2t-int8" and sweep.startswith("batch") else ""
    text = (
        "bit-equal"
        if equal
        else f"differ by at most {difference:.2g}, {difference / size / 6e-8:.2g} roundings of float32"
    )
    return {
        "sweep": f"repeat: {sweep}",
        "solver": solver,
        "unit": "map",
        "bit_equal": equal,
        "worst": rounded(difference),
        "degrades_10pct_at": None,
        "breaks_at": None,
        "why": left_out or text + aside * (not equal),
    }


def _digest_elsewhere(bundle: Bundle, changes: Floats) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "eitskin_tools.bench.stability.sweeps.repeat", str(bundle.path)],
        input=changes.astype("<f4").tobytes(), capture_output=True, check=True, timeout=120,
    )  # fmt: skip
    return done.stdout.decode().strip()


def _session(graph: bytes, threads: int = 1) -> Any:
    return onnxruntime.InferenceSession(graph, session_options(threads), providers=["CPUExecutionProvider"])


def _session_maps(bundle: Bundle, name: str, changes: Floats, *, threads: int) -> Floats:
    session = _session(bundle.files[name], threads)
    return np.concatenate([session.run(["map"], _feed(bundle, change[None]))[0] for change in changes])


class UnbatchedError(ValueError):
    """A head that takes one frame at a time."""


def _batch_maps(bundle: Bundle, name: str, changes: Floats) -> Floats:
    """Return the maps of a head whose batch of one was made a free dimension.

    Raises:
        UnbatchedError: A symmetric head puts four images where others have a batch; or only the first map comes out.
    """
    if bundle.manifest.get("recipe", {}).get("architecture", {}).get("symmetric"):
        raise UnbatchedError("four images of one frame stand where a batch would")
    import onnx

    model = onnx.load_model_from_string(bundle.files[name])
    for value in (*model.graph.input, *model.graph.output):
        value.type.tensor_type.shape.dim[0].dim_param = "batch"
    session = _session(model.SerializeToString())
    maps = np.asarray(session.run(["map"], _feed(bundle, changes))[0])
    if len(maps) != len(changes):
        raise UnbatchedError(f"the head gives {len(maps)} map of {len(changes)} frames: its last gather is of one")
    return maps


def _feed(bundle: Bundle, changes: Floats) -> dict[str, Floats]:
    geometry = GeometryGraph(bundle).geometry(None, None, 0)
    feed = {"dv": changes, "bias": np.repeat(geometry.bias, len(changes), axis=0)}
    if bundle.uses_prediction:
        feed["log_predicted"] = np.repeat(geometry.log_predicted, len(changes), axis=0)
    return feed


if __name__ == "__main__":
    given = np.frombuffer(sys.stdin.buffer.read(), dtype="<f4").reshape(-1, 104)
    print(digest(maps_of(load_bundle(sys.argv[1]), given)))
