"""Computes the head's inputs from a cloud: the geometry graph runs when a cloud arrives, in the thread that brought it.

It yields a :class:`Geometry`, which the frame loop copies in between two frames.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.model.bundle import EXPORT_HINT, Bundle, graphs_of
from eitskin.model.denormals import flushed
from eitskin.model.session import check_signature, checked_graph, first_line, open_session
from eitskin.touches.surface import Surface
from eitskin_proto.skin.cloud import network_input

GEOMETRY_FILE: Final = "geometry.onnx"
"""The file of the bundle's own network."""


@dataclass(frozen=True, slots=True, eq=False)
class GivenCloud:
    """A surface as it was sent, or found."""

    cloud: npt.NDArray[np.float32] | None
    """(3, rows, columns) mm; None for the flat sheet."""
    predicted: npt.NDArray[np.float64] | None
    """(104,) V"""
    predicted_flat: npt.NDArray[np.float64] | None
    """(104,) V"""
    taken_ns: int
    """On ``perf_counter_ns``."""
    utc_ns: int
    """Wall clock."""
    is_fitted: bool = False
    """Whether physics found it in frames, since nothing scanned the sheet."""


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """The head's inputs from a cloud; immutable, so that it may cross threads."""

    bias: npt.NDArray[np.float32]
    """(1, H) the cloud's bias in the first fusion layer; empty without a network."""
    beside: Mapping[str, npt.NDArray[np.float32]]
    """(1, H) likewise of each network beside the bundle's own, by its name."""
    log_predicted: npt.NDArray[np.float32]
    """(1, rows) log |V_pred| / |V0|; zeros without a prediction."""
    revision: int
    """Counts clouds since the start; 0 is the flat sheet."""
    surface: Surface
    """The cloud in the pose in which it was given."""
    given: GivenCloud | None = None
    """The surface; None for the flat sheet with which a runtime starts."""
    unlike: tuple[str, ...] = ()
    """In which ways it is unlike the surfaces of the training (:mod:`eitskin_proto.skin.familiar_shape`)."""

    @property
    def why(self) -> str:
        """``start``, ``flat``, ``given`` or ``fitted``, as the stream of clouds says it."""
        if self.given is None or self.given.cloud is None:
            return "start" if self.given is None else "flat"
        return "fitted" if self.given.is_fitted else "given"


class GeometryGraph:
    """From clouds to geometries; not part of the frame loop. Without a network only the surface counts.

    Sessions are open until :meth:`close_sessions` and opened again by the next cloud: a skin that never gets one needs
    them once.

    Args:
        bundle: Where the graph is.

    Raises:
        BundleError: The graph cannot be loaded or has another signature.
    """

    def __init__(self, bundle: Bundle) -> None:
        self._bundle = bundle
        self._grid = bundle.skin.grid
        self._beside = {name: graphs_of(name)[0] for name in bundle.beside}
        self._widths = {self._beside[name]: width for name, width in bundle.beside.items()}
        if bundle.has_network:
            self._widths = {GEOMETRY_FILE: bundle.bias_width} | self._widths
        self._sessions: dict[str, Any] = {}
        for file in self._widths:
            self._open(file)

    def _open(self, file: str) -> Any:
        if file not in self._sessions:
            session = open_session(self._bundle, file, checked_graph(self._bundle, file))
            expected = {"cloud": (1, *self._grid.cloud_shape)}
            check_signature(file, session, expected, "bias", (1, self._widths[file]))
            self._sessions[file] = session
        return self._sessions[file]

    def close_sessions(self) -> None:
        """Give the sessions' 5 MB back until the next cloud, which then takes 15 ms more."""
        self._sessions.clear()

    def geometry(
        self, cloud: npt.ArrayLike | None, log_predicted: npt.NDArray[np.float32] | None, revision: int
    ) -> Geometry:
        """Return the head's inputs from a cloud.

        Args:
            cloud: (3, rows, columns) mm in any pose; None for the flat sheet.
            log_predicted: (104,) of :func:`eitskin.reference.predicted.log_ratio`; None for zeros.
            revision: Number of this cloud.

        Raises:
            BundleError: The graph cannot be computed.
            ValueError: The cloud is malformed, or the network answers it with values that are not finite.
        """
        given = self._grid.flat_cloud_mm() if cloud is None else cloud
        points = flushed(network_input(given, self._grid))[np.newaxis]
        biases = {file: self._bias(file, points, flat=cloud is None) for file in self._widths}
        beside = {name: biases[file] for name, file in self._beside.items()}
        predicted = np.zeros((1, self._bundle.rows), dtype=np.float32)
        if log_predicted is not None:
            predicted[0] = log_predicted
        surface = Surface(np.asarray(given), self._grid)
        own = biases.get(GEOMETRY_FILE, np.zeros((1, 0), dtype=np.float32))
        return Geometry(own, beside, flushed(predicted), revision, surface)

    def _bias(self, file: str, points: npt.NDArray[np.float32], *, flat: bool) -> npt.NDArray[np.float32]:
        try:
            bias = self._open(file).run(["bias"], {"cloud": points})[0]
        except BundleError:
            raise
        except Exception as error:  # onnxruntime's exceptions share no base of their own
            raise BundleError(f"{file} cannot be computed ({first_line(error)}); {EXPORT_HINT}") from error
        if flat and not np.isfinite(bias).all():
            raise BundleError(f"{file} gives values that are not finite for the flat sheet; {EXPORT_HINT}")
        if not np.isfinite(bias).all():
            raise ValueError(
                "the geometry graph gives values that are not finite for this cloud; scan the surface again"
            )
        return flushed(bias)
