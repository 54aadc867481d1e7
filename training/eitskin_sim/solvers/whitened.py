"""Operators that know no bend: the flat sheet's, with rows whitened by the covariance of untouched sheets.

    l = log(V / V0)        C = cov(l of untouched, bent devices) + noise + common factor        W C W^T = 1

Without W a solver needs the bend, from a cloud, since a bend changes V more than a touch does. With W the bend is
noise, of few directions, and the others show the touch. On 32 phantoms at bends, without any cloud, the CC of Tikhonov
rises from 0.56 to 0.72, and that of l1 from 0.38 to 0.85.
"""

from typing import Final

import numpy as np

from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.arrays import Array
from eitskin_sim.solvers.operators import SATURATED_CONTRAST

COMMON_SD: Final = 0.05
"""Standard deviation of the logarithm of the factor common to all rows: drift since the reference."""

LEAST_NOISE: Final = 1e-3
"""Of l: the model is no better."""

DAMPING: Final = 100.0
"""Tikhonov's, where whitened noise is 1; best of 1 to 1000 on 32 phantoms at bends."""

SIGNS: Final[dict[TouchKind, float]] = {"raise": 1.0, "lower": -1.0, "both": 0.0}
"""Of the change of conductance that solvers look for; 0 is either."""


def whitening_of(untouched: Array, noise_sd: Array) -> Array:
    """Return the (rows, rows) W.

    Args:
        untouched: (n, rows) l of untouched sheets, free of noise.
        noise_sd: (rows,) standard deviation of l by noise.
    """
    around = untouched.T @ untouched / len(untouched)  # about 0, where the flat sheet is
    noise = np.diag(np.maximum(noise_sd, LEAST_NOISE) ** 2)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(around + noise + COMMON_SD**2)))


def l1_arrays(whitening: Array, jacobian: Array, touches: TouchKind) -> dict[str, Array]:
    """Return the arrays of a bundle's l1.npz (:mod:`eitskin.model.sparse`).

    Args:
        whitening: (rows, rows) W.
        jacobian: (rows, pixels) relative change of each row with that of each pixel's conductivity; 0 off the sheet.
        touches: Which way they change conductance.
    """
    operator = whitening @ jacobian
    size = np.linalg.norm(operator, axis=0)
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    return {
        "whitening": whitening,
        "operator": (operator * scale).astype(np.float32),
        "scale": scale,
        "limit": SATURATED_CONTRAST * size,
        "sign": np.array(SIGNS[touches]),
    }


def tikhonov_of_logs(whitening: Array, jacobian: Array, touches: TouchKind) -> Array:
    """Return the (pixels, rows) matrix from l to an image, positive where something touches; arguments as above."""
    operator = whitening @ jacobian
    weight = np.sqrt(np.linalg.norm(jacobian, axis=0))
    scaled = np.divide(operator, weight, out=np.zeros_like(operator), where=weight > 0.0)
    image = np.linalg.solve(scaled @ scaled.T + DAMPING * np.eye(len(operator)), scaled).T @ whitening
    image = np.divide(image, weight[:, None], out=np.zeros_like(image), where=weight[:, None] > 0.0)
    return np.asarray(-image if touches == "lower" else image)
