"""The memory that all engines share: the inputs of a frame and a cloud, and the map."""

from typing import Protocol

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin.model.geometry import Geometry
from eitskin.touches.surface import Surface


class Engine(Protocol):
    """One way from ``Buffers.change`` to ``Buffers.map``."""

    @property
    def name(self) -> str:
        """Its name in frames: ``vd2t``, ``vd2t-int8``, ``vd2t-small``, ``taught``, ``l1``, ``tikhonov``."""

    def infer(self) -> None:
        """Fill the map from dV, without making an array."""


class Buffers:
    """The memory that all engines share.

    Args:
        bundle: Gives the width of the bias and the size of the map.
        change: (rows,) memory for dV that is shared; None makes it.
    """

    __slots__ = ("beside", "bias", "change", "geometry", "log_predicted", "map", "revision", "surface")

    def __init__(self, bundle: Bundle, change: npt.NDArray[np.float32] | None = None) -> None:
        rows = bundle.rows
        self.change = np.zeros((1, rows), dtype=np.float32) if change is None else change.reshape(1, rows)
        """(1, rows) dV of the frame."""
        self.bias = np.zeros((1, bundle.bias_width), dtype=np.float32)
        """(1, H)."""
        self.beside = {name: np.zeros((1, width), dtype=np.float32) for name, width in bundle.beside.items()}
        """(1, H) of each network beside the bundle's own."""
        self.log_predicted = np.zeros((1, rows), dtype=np.float32)
        """(1, rows)."""
        self.map = np.zeros((1, bundle.skin.grid.n_pixels), dtype=np.float32)
        """(1, pixels) the result."""
        self.revision = 0
        """Of the cloud in use."""
        self.geometry: Geometry | None = None
        """The geometry used last."""
        self.surface = Surface(bundle.skin.grid.flat_cloud_mm(), bundle.skin.grid)
        """The cloud in use, as it was given."""

    def use_geometry(self, geometry: Geometry) -> None:
        """Use another geometry from the next frame on."""
        self.geometry = geometry
        self.bias[:] = geometry.bias
        for name, bias in self.beside.items():
            bias[:] = geometry.beside[name]
        self.log_predicted[:] = geometry.log_predicted
        self.revision = geometry.revision
        self.surface = geometry.surface
