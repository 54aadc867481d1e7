"""Turns dV into a map: the network's head, its int8 twin, or one matrix; all read and write the same fixed memory.

:class:`eitskin.model.buffers.Buffers` is made once. Every engine is bound to it, so that a frame costs one call and no
array. The cloud's inputs were computed before (:mod:`eitskin.model.geometry`). ::

    cloud --GeometryGraph--> Geometry(bias, log_predicted) --Buffers.use_geometry--> bias, log_predicted
    dV ------------------------------------------------------------------> change --Engine.infer--> map
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.model.buffers import Buffers, Engine
from eitskin.model.bundle import EXPORT_HINT, L1_FILE, TAUGHT_FILE, Bundle, graphs_of
from eitskin.model.denormals import flushed
from eitskin.model.gentle import GentleEngine
from eitskin.model.manifest import GENTLE, SMALL
from eitskin.model.session import check_signature, checked_graph, first_line, onnxruntime, open_session
from eitskin.model.sparse import Logarithms, SparseEngine, sign_of
from eitskin.model.taught import TaughtField

VD2T_SMALL: Final = "vd2t-small"
"""The head of a smaller network, which some bundles have in addition."""

HEADS: Final = {"vd2t": "head.onnx", "vd2t-int8": "head_int8.onnx", VD2T_SMALL: graphs_of(SMALL)[1]}
"""Names of heads in frames, and their files; from the most accurate to the fastest."""

QUANTISED: Final = "vd2t-int8"
"""The head that takes half the time."""

TAUGHT: Final = "taught"
"""The solver that learned from presses; its gate is its own, too."""

PROJECTION: Final = "tikhonov"

SCALED: Final = ("l1", PROJECTION)
"""Solvers whose maps cannot say that nothing touches: they are scaled to 1 whatever they show."""

FILES: Final = {TAUGHT: TAUGHT_FILE, "l1": L1_FILE, PROJECTION: "tikhonov.npy"}
"""Solvers without a network, and their files; from the most accurate to the fastest."""

SMALLEST_MAP: Final = 1e-12
"""A projection below this is zero, not something to scale up."""


class HeadEngine:
    """The network's head, in float32 or int8.

    Args:
        bundle: Where the graph is.
        file: A graph of :data:`HEADS`, or another head of a network beside the bundle's own.
        name: Its name in frames.
        buffers: Bound as inputs and output.

    Raises:
        BundleError: The graph cannot be loaded, or has another signature.
    """

    __slots__ = ("_binding", "_session", "_values", "name")

    def __init__(
        self,
        bundle: Bundle,
        file: str,
        name: str,
        buffers: Buffers,
    ) -> None:
        self.name = name
        self._session = open_session(bundle, file, checked_graph(bundle, file))
        arrays = {"dv": buffers.change, "bias": _bias_of(file, buffers)}
        if bundle.uses_prediction:
            arrays["log_predicted"] = buffers.log_predicted
        shapes = {key: value.shape for key, value in arrays.items()}
        check_signature(file, self._session, shapes, "map", buffers.map.shape)
        self._binding = self._session.io_binding()
        # The OrtValues borrow the arrays' memory; both must outlive the binding.
        self._values = {key: onnxruntime.OrtValue.ortvalue_from_numpy(value) for key, value in arrays.items()}
        for key, value in self._values.items():
            self._binding.bind_ortvalue_input(key, value)
        self._values["map"] = onnxruntime.OrtValue.ortvalue_from_numpy(buffers.map)
        self._binding.bind_ortvalue_output("map", self._values["map"])

    def infer(self) -> None:
        """Fill the map.

        Raises:
            BundleError: The graph cannot be computed.
        """
        try:
            self._session.run_with_iobinding(self._binding)
        except Exception as error:  # onnxruntime's exceptions share no base of their own
            raise BundleError(f"{self.name} cannot be computed ({first_line(error)}); {EXPORT_HINT}") from error


class TaughtEngine:
    """The place of a touch by what the sheet was taught; its gate has computed it already.

    Args:
        field: Judges each frame before.
        buffers: Written.
    """

    __slots__ = ("_field", "_map", "name")

    def __init__(self, field: TaughtField, buffers: Buffers) -> None:
        self.name = TAUGHT
        self._field, self._map = field, buffers.map[0]

    def infer(self) -> None:
        """Fill the map."""
        self._field.fill_map(self._map)


class ProjectionEngine:
    """Tikhonov for the flat sheet: one matrix times dV, cut off at zero and scaled to 1.

    Beside the operators of l1 the matrix takes the logarithms of 1 + dV, as these do.

    Args:
        bundle: Where the matrix is.
        buffers: Read and written.

    Raises:
        BundleError: The matrix cannot be read.
    """

    __slots__ = ("_change", "_logs", "_map", "_matrix", "_signed", "_whole", "name")

    def __init__(self, bundle: Bundle, buffers: Buffers) -> None:
        self.name = PROJECTION
        self._whole = self._matrix = flushed(bundle.tikhonov())
        self._change = buffers.change[0]
        arrays = bundle.l1_arrays()
        self._logs = None if arrays is None else Logarithms(self._change)
        if self._logs is not None:
            self._change = self._logs.values
        self._signed = arrays is not None and sign_of(arrays) == 0.0
        self._map = buffers.map[0]

    def change_matrix(self, change: Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]]) -> None:
        """Replace the bundle's matrix by ``change`` of it from the next frame on, such as one without some rows."""
        self._matrix = flushed(change(self._whole))

    def infer(self) -> None:
        """Fill the map; negative values become 0, since a touch only adds, and the largest value becomes 1.

        Where touches raise and lower conductance, negative values become positive.
        """
        if self._logs is not None:
            self._logs.take()
        np.matmul(self._matrix, self._change, out=self._map)
        if self._signed:
            np.abs(self._map, out=self._map)
        np.maximum(self._map, 0.0, out=self._map)
        largest = float(self._map.max())
        if largest > SMALLEST_MAP:
            np.divide(self._map, largest, out=self._map)


def engines(
    bundle: Bundle,
    buffers: Buffers,
    *,
    best: str | None = None,
    alone: bool = False,
    field: TaughtField | None = None,
) -> list[Engine]:
    """Return every engine that a bundle offers, from the most accurate to the fastest.

    Args:
        bundle: Where they are.
        buffers: The engines' memory.
        best: Leave out those before the one of this name; None leaves none out.
        alone: Leave out those behind the first; without ``best`` it is :func:`default_solver`.
        field: Judges each frame first, where the bundle was taught; None leaves its solver out.

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
    wanted = [name for name in names if name in HEADS]
    if wanted and GENTLE in bundle.beside:
        heads = _with_gentle(bundle, wanted, buffers)
    else:
        heads = [HeadEngine(bundle, HEADS[name], name, buffers) for name in wanted]
    others: list[Engine] = []
    for name in names:
        if name == TAUGHT and field is not None:
            others.append(TaughtEngine(field, buffers))
        elif name == "l1":
            others.append(SparseEngine(bundle.l1_arrays() or {}, buffers.change[0], buffers.map[0]))
        elif name == PROJECTION:
            others.append(ProjectionEngine(bundle, buffers))
    return [*heads, *others]


def longest(engine: Engine) -> Callable[[], None]:
    """Return what does all that a frame may take of an engine."""
    return engine.infer_both if isinstance(engine, GentleEngine) else engine.infer


def solvers(bundle: Bundle) -> list[str]:
    """Return the names of a bundle's solvers, from the most accurate to the fastest."""
    heads = [name for name, file in HEADS.items() if file in bundle.files]
    if SMALL not in bundle.beside and VD2T_SMALL in heads:
        heads.remove(VD2T_SMALL)
    return [*heads, *(name for name, file in FILES.items() if file in bundle.files)]


def default_solver(bundle: Bundle) -> str:
    """Return the solver of a stream that has no latency budget, and so no reason to change it.

    That is the int8 head, which takes half the time, where the bundle's metrics card says that less than one pixel of a
    frame's map is above half height in one head's map and below in the other's; else the most accurate solver.
    """
    names = solvers(bundle)
    return QUANTISED if QUANTISED in names and flipped_pixels(bundle) < 1.0 else names[0]


def flipped_pixels(bundle: Bundle) -> float:
    """Return how many pixels of a map the 8-bit head shows on the other side of half height; infinite if unknown."""
    try:
        flipped = float(bundle.manifest["metrics"]["int8"]["flipped"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return math.inf
    return flipped * bundle.skin.grid.n_pixels if flipped >= 0.0 else math.inf


def _bias_of(file: str, buffers: Buffers) -> npt.NDArray[np.float32]:
    """Return the cloud's bias in the network of a head."""
    return next((bias for name, bias in buffers.beside.items() if file == graphs_of(name)[1]), buffers.bias)


def _with_gentle(bundle: Bundle, names: list[str], buffers: Buffers) -> list[Engine]:
    """Return heads with the network for gentle touches behind them, which is one for all."""
    gentle = HeadEngine(bundle, graphs_of(GENTLE)[1], GENTLE, buffers)
    return [
        GentleEngine(
            HeadEngine(bundle, HEADS[name], name, buffers), gentle, buffers.map, bundle.skin, asks=name != VD2T_SMALL
        )
        for name in names
    ]
