"""Frames of the flat sheet, for tests of the verifier of shapes."""

from functools import lru_cache
from itertools import count

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.verification.fit import Frame
from eitskin_sim.verification.network_map import map_of
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.shape_verifier import ShapeVerifier
from eitskin_sim.verification.sheet_model import SheetModel, flat_model_V, model_of_cloud

Array = npt.NDArray[np.float64]

SQUARE = np.array([[0, 60.0, 45.0, 12.0, 10.0, 0.0, 50.0, 0.0]])
OTHER = np.array([[0, 110.0, 70.0, 10.0, 10.0, 0.0, 50.0, 0.0]])
ELL = np.array([[0, 45.0, 50.0, 10.0, 40.0, 0.0, 50.0, 0.0], [0, 60.5, 35.0, 19.0, 10.0, 0.0, 50.0, 0.0]])
"""Two rectangles with a crack of 1 mm between them."""

NOTHING = np.zeros((0, 8))


def changed(pieces: Array, **by: float) -> Array:
    """Return touches with some columns moved."""
    columns = {"x": 1, "y": 2, "length": 3, "width": 4, "angle": 5, "contrast": 6, "border": 7}
    found = pieces.copy()
    for name, step in by.items():
        found[:, columns[name]] += step
    return found


def shares_of(*touches: Array) -> Array:
    """Return (n, rows, columns) the shares of a map that shows touches, each of some pieces."""
    return np.array([map_of(np.atleast_2d(one)) for one in touches]).reshape(len(touches), *PAPER.grid.shape)


def noisy(volts: Array, seed: int = 3) -> Array:
    """Return voltages with noise of 50 dB."""
    return np.asarray(volts * (1.0 + 10**-2.5 * np.random.default_rng(seed).standard_normal(len(volts))))


@lru_cache(maxsize=1)
def flat_model() -> SheetModel:
    return model_of_cloud(flat_cloud())


def read(pieces: Array, seed: int = 3) -> Array:
    """Return (104,) V of a frame of the flat sheet."""
    return noisy(flat_model().touched.solve(pieces).voltages_V, seed)


def flat_verifier(touches: TouchKind = "raise") -> ShapeVerifier:
    """Return a verifier of the flat sheet whose time is counted in looks at the clock."""
    looks = count()
    found = ShapeVerifier(flat_model_V(PAPER), Noise("N2", 50.0), touches, clock=lambda: float(next(looks)))
    found.deformation.scan(flat_model)
    return found


def frame_of(pieces: Array, touches: TouchKind = "raise", n_shown: int = 0) -> Frame:
    """Return a frame of the flat sheet, against its model."""
    return flat_verifier(touches).frame(read(pieces) / flat_model_V(PAPER) - 1.0, None, n_shown)


def correlation(one: Array, other: Array) -> float:
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])
