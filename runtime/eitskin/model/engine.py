"""Turns dV into a map: the network's head, its int8 twin, or one matrix; all read and write the same fixed memory.

:class:`Buffers` is made once. Every engine is bound to it, so that a frame costs one call and no array. The geometry
graph is not part of the loop: :class:`GeometryGraph` runs when a cloud arrives, in the thread that brought it, and
yields a :class:`Geometry` that the frame loop copies in between two frames. ::

    cloud --GeometryGraph--> Geometry(bias, log_predicted) --Buffers.take--> bias, log_predicted
    dV ----------------------------------------------------------> change --Engine.infer--> map

ONNX Runtime gets one thread that is the caller's: its own pool escapes CPU pinning and costs 8 ms at p99 under load.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt
import onnxruntime

from eitskin.errors import BundleError, MismatchError, UncutError
from eitskin.model.bundle import EXPORT_HINT, Bundle
from eitskin_proto.sensor.cloud import flat_cloud, network_input
from eitskin_proto.sensor.grid import N_PIXELS
from eitskin_proto.sensor.ids import GRID_ID, PROTOCOL_ID
from eitskin_proto.sensor.table import N_ROWS

HEADS: Final = {"vd2t": "head.onnx", "vd2t-int8": "head_int8.onnx"}
"""What frames call a head, and its file."""

QUANTISED: Final = "vd2t-int8"
"""The head that takes half the time."""

SMALLEST_MAP: Final = 1e-12
"""A projection below this is zero, not something to scale up."""


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """What a cloud means to the head; immutable, so that it may cross threads."""

    bias: npt.NDArray[np.float32]
    """(1, H) what the cloud adds in the first fusion layer."""
    log_predicted: npt.NDArray[np.float32]
    """(1, 104) log |V_pred| / |V0|; zeros without a prediction."""
    revision: int
    """Counts clouds since the start; 0 is the flat sheet."""


class Buffers:
    """The memory that all engines share.

    Args:
        bias_width: H.
        change: (104,) memory for dV that somebody else reads as well; None makes it.
    """

    __slots__ = ("bias", "change", "log_predicted", "map", "revision")

    def __init__(self, bias_width: int, change: npt.NDArray[np.float32] | None = None) -> None:
        self.change = np.zeros((1, N_ROWS), dtype=np.float32) if change is None else change.reshape(1, N_ROWS)
        """(1, 104) dV of the frame."""
        self.bias = np.zeros((1, bias_width), dtype=np.float32)
        """(1, H)."""
        self.log_predicted = np.zeros((1, N_ROWS), dtype=np.float32)
        """(1, 104)."""
        self.map = np.zeros((1, N_PIXELS), dtype=np.float32)
        """(1, 1350) the result."""
        self.revision = 0
        """Of the cloud in use."""

    def take(self, geometry: Geometry) -> None:
        """Use another geometry from the next frame on."""
        self.bias[:] = geometry.bias
        self.log_predicted[:] = geometry.log_predicted
        self.revision = geometry.revision


class Engine(Protocol):
    """One way from ``Buffers.change`` to ``Buffers.map``."""

    @property
    def name(self) -> str:
        """What frames call it: ``vd2t``, ``vd2t-int8``, ``tikhonov``."""

    def infer(self) -> None:
        """Fill the map from dV, without making an array."""


class HeadEngine:
    """The network's head, in float32 or int8.

    Args:
        bundle: Where the graph is.
        file: ``head.onnx`` or ``head_int8.onnx``.
        name: What frames call it.
        buffers: Bound as inputs and output.
        pixels: (n,) the only pixels that are computed, ascending; None for all. The others keep their values.
        graph: Instead of the file's; it gives the pixels alone.

    Raises:
        BundleError: The graph cannot be loaded, or has another signature.
    """

    __slots__ = ("_binding", "_map", "_part", "_pixels", "_session", "_values", "name")

    def __init__(
        self,
        bundle: Bundle,
        file: str,
        name: str,
        buffers: Buffers,
        pixels: npt.NDArray[np.intp] | None = None,
        graph: bytes | None = None,
    ) -> None:
        self.name = name
        self._pixels = pixels
        self._map = buffers.map[0]
        self._part = buffers.map if pixels is None else np.zeros((1, len(pixels)), dtype=np.float32)
        self._session = _session(bundle, file, bundle.files[file] if graph is None else graph)
        arrays = {"dv": buffers.change, "bias": buffers.bias}
        if bundle.uses_prediction:
            arrays["log_predicted"] = buffers.log_predicted
        shapes = {key: value.shape for key, value in arrays.items()}
        _check_signature(file, self._session, shapes, "map", self._part.shape)
        self._binding = self._session.io_binding()
        # The OrtValues borrow the arrays' memory; both must outlive the binding.
        self._values = {key: onnxruntime.OrtValue.ortvalue_from_numpy(value) for key, value in arrays.items()}
        for key, value in self._values.items():
            self._binding.bind_ortvalue_input(key, value)
        self._values["map"] = onnxruntime.OrtValue.ortvalue_from_numpy(self._part)
        self._binding.bind_ortvalue_output("map", self._values["map"])

    def infer(self) -> None:
        """Fill the map, or its pixels."""
        self._session.run_with_iobinding(self._binding)
        if self._pixels is not None:
            self._map[self._pixels] = self._part[0]


class ProjectionEngine:
    """Tikhonov for the flat sheet: one matrix times dV, cut off at zero and scaled to 1.

    Args:
        bundle: Where the matrix is.
        buffers: Read and written.
        pixels: (n,) the only pixels that are computed, ascending; None for all. The largest of them becomes 1.
    """

    __slots__ = ("_change", "_map", "_matrix", "_part", "_pixels", "_whole", "name")

    def __init__(self, bundle: Bundle, buffers: Buffers, pixels: npt.NDArray[np.intp] | None = None) -> None:
        self.name = "tikhonov"
        self._whole = bundle.tikhonov() if pixels is None else bundle.tikhonov()[pixels]
        self._matrix = self._whole
        self._change = buffers.change[0]
        self._map = buffers.map[0]
        self._pixels = pixels
        self._part = self._map if pixels is None else np.zeros(len(pixels), dtype=np.float32)

    def change_matrix(self, change: Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]]) -> None:
        """Use what ``change`` makes of the bundle's matrix from the next frame on: one without some rows."""
        self._matrix = change(self._whole)

    def infer(self) -> None:
        """Fill the map; what is negative becomes 0, since a touch only adds, and the largest value becomes 1."""
        np.matmul(self._matrix, self._change, out=self._part)
        np.maximum(self._part, 0.0, out=self._part)
        largest = float(self._part.max())
        if largest > SMALLEST_MAP:
            np.divide(self._part, largest, out=self._part)
        if self._pixels is not None:
            self._map[self._pixels] = self._part


class MaskedEngine:
    """A whole map with all but some pixels set to 0: where a network's last layer cannot be cut down to pixels.

    Args:
        engine: Fills the whole map.
        buffers: Whose map that is.
        pixels: (n,) those that stay.
    """

    __slots__ = ("_engine", "_kept", "_map", "name")

    def __init__(self, engine: Engine, buffers: Buffers, pixels: npt.NDArray[np.intp]) -> None:
        self.name = engine.name
        self._engine = engine
        self._map = buffers.map[0]
        self._kept = np.zeros(N_PIXELS, dtype=np.float32)
        self._kept[pixels] = 1.0

    def infer(self) -> None:
        """Fill the map."""
        self._engine.infer()
        np.multiply(self._map, self._kept, out=self._map)


class GeometryGraph:
    """From clouds to geometries; not part of the frame loop.

    The session is made with the first call and forgotten by :meth:`rest`: a skin that never gets a cloud needs it once.

    Args:
        bundle: Where the graph is.

    Raises:
        BundleError: The graph cannot be loaded or has another signature.
    """

    def __init__(self, bundle: Bundle) -> None:
        self._bundle = bundle
        self._session: Any = None
        self._open()

    def _open(self) -> Any:
        if self._session is None:
            bundle = self._bundle
            self._session = _session(bundle, "geometry.onnx", bundle.files["geometry.onnx"])
            expected = {"cloud": (1, 3, 30, 45)}
            _check_signature("geometry.onnx", self._session, expected, "bias", (1, bundle.bias_width))
        return self._session

    def rest(self) -> None:
        """Give the session's 5 MB back until the next cloud, which then takes 15 ms more."""
        self._session = None

    def geometry(
        self, cloud: npt.ArrayLike | None, log_predicted: npt.NDArray[np.float32] | None, revision: int
    ) -> Geometry:
        """Return what a cloud means to the head.

        Args:
            cloud: (3, 30, 45) mm in any pose; None for the flat sheet.
            log_predicted: (104,) of :func:`eitskin.reference.predicted.log_ratio`; None for zeros.
            revision: Number of this cloud.

        Raises:
            ValueError: The cloud is malformed, or the network answers it with values that are not finite.
        """
        points = network_input(flat_cloud() if cloud is None else cloud)
        bias = self._open().run(["bias"], {"cloud": points[np.newaxis]})[0]
        if not np.isfinite(bias).all():
            raise ValueError("the geometry graph answers this cloud with non-finite values; scan the sheet again")
        predicted = np.zeros((1, N_ROWS), dtype=np.float32)
        if log_predicted is not None:
            predicted[0] = log_predicted
        return Geometry(bias, predicted, revision)


def engines(
    bundle: Bundle,
    buffers: Buffers,
    pixels: npt.NDArray[np.intp] | None = None,
    *,
    best: str | None = None,
    alone: bool = False,
) -> list[Engine]:
    """Return every engine that a bundle offers, from the most accurate to the fastest.

    Args:
        bundle: Where they are.
        buffers: What they read and write.
        pixels: (n,) the only pixels to compute, ascending; None for all.
        best: Leave out those before the one of this name; None leaves none out.
        alone: Leave out those behind the first; without ``best`` it is :func:`default_solver`.

    Raises:
        ValueError: The bundle has no solver of this name.
    """
    found = solvers(bundle)
    if best is not None and best not in found:
        raise ValueError(f"solver {best!r} does not exist; this bundle has {', '.join(found)}")
    if best is None:
        best = default_solver(bundle) if alone else found[0]
    names = found[found.index(best) :]
    if alone:
        del names[1:]
    return [
        _head(bundle, HEADS[name], name, buffers, pixels)
        if name in HEADS
        else ProjectionEngine(bundle, buffers, pixels)
        for name in names
    ]


def solvers(bundle: Bundle) -> list[str]:
    """Return the names of what a bundle offers, from the most accurate to the fastest."""
    return [*(name for name, file in HEADS.items() if file in bundle.files), "tikhonov"]


def default_solver(bundle: Bundle) -> str:
    """Return the solver of a stream that has no latency budget, and so no reason to change it.

    That is the int8 head, which takes half the time, where the bundle's metrics card says that less than one pixel of a
    frame's map is above half height in one head's map and below in the other's; else the most accurate solver.
    """
    names = solvers(bundle)
    try:
        flipped = float(bundle.manifest["metrics"]["int8"]["flipped"])
    except (KeyError, TypeError, ValueError):
        flipped = 1.0
    return QUANTISED if QUANTISED in names and 0.0 <= flipped < 1.0 / N_PIXELS else names[0]


def _head(bundle: Bundle, file: str, name: str, buffers: Buffers, pixels: npt.NDArray[np.intp] | None) -> Engine:
    if pixels is None:
        return HeadEngine(bundle, file, name, buffers)
    from eitskin.model.onnx.crop import cut  # noqa: PLC0415 -- only regions need it

    try:
        return HeadEngine(bundle, file, name, buffers, pixels, cut(bundle.files[file], pixels, N_PIXELS))
    except UncutError:
        return MaskedEngine(HeadEngine(bundle, file, name, buffers), buffers, pixels)


def _session(bundle: Bundle, file: str, graph: bytes) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions share no base of their own
        raise BundleError(f"{bundle.path}: {file} cannot be loaded ({_first_line(error)}); {EXPORT_HINT}") from error
    if hasattr(session, "_model_bytes"):
        session._model_bytes = b""  # kept for a change of provider, which never comes: as many bytes as the weights
    metadata = session.get_modelmeta().custom_metadata_map
    for key, expected in (("protocol_id", PROTOCOL_ID), ("grid_id", GRID_ID)):
        if metadata.get(key, expected) != expected:
            raise MismatchError(f"{file}: {key}", found=metadata[key], expected=expected, hint=EXPORT_HINT)
    return session


def _check_signature(
    file: str, session: Any, inputs: Mapping[str, tuple[int, ...]], output: str, shape: tuple[int, ...]
) -> None:
    found = {value.name: tuple(value.shape) for value in session.get_inputs()}
    if found != inputs:
        raise BundleError(f"{file}: inputs found {found}, expected {inputs}; {EXPORT_HINT}")
    outputs = {value.name: tuple(value.shape) for value in session.get_outputs()}
    if outputs != {output: shape}:
        raise BundleError(f"{file}: outputs found {outputs}, expected {{{output!r}: {shape}}}; {EXPORT_HINT}")
    kinds = {value.type for value in (*session.get_inputs(), *session.get_outputs())}
    if kinds != {"tensor(float)"}:
        raise BundleError(f"{file}: types found {sorted(kinds)}, expected tensor(float) alone; {EXPORT_HINT}")


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0][:200]
