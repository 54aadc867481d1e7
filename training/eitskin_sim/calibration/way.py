"""Which way touches change conductance, from one press at an unknown place.

The change of a press is compared with the model's own prediction of a small touch at every place, for either sign ::

    gain = (p^T C^-1 d)^2 / p^T C^-1 p          p (rows,) the relative change of rows by a touch, d the measured change

C holds the noise as measured, a common drift, and an error of the model in proportion to the change. The sign of the
place that gains most is the answer, if the best place of the other sign is far less likely.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import SkinError
from eitskin_proto.sensor.noise_law import noise_of
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.arrays import Array
from eitskin_sim.solvers.operators import build_operators

TOUCH_SIGMA_MM: Final = 8.0
"""Of the touch that is looked for."""

DRIFT: Final = 0.005
"""Common to all rows since the untouched frames."""

MODEL_ERROR: Final = 0.1
"""Of a row, over the rms of the change."""

MIN_GAIN: Final = 25.0
"""Of a press that is felt."""

MIN_LOG_RATIO: Final = 3.0
"""Log likelihood of one sign over that of the other."""


class PressError(SkinError, ValueError):
    """A press that does not say which way touches go."""


@dataclass(frozen=True, slots=True)
class PressWay:
    """What a press says."""

    kind: TouchKind
    """``lower`` or ``raise``, as in the skin's file."""
    log_ratio: float
    """Log likelihood of this kind over the other."""
    xy_mm: tuple[float, float]
    """Where the press was found."""


def press_way(untouched_V: Array, pressed_V: Array, skin: Skin) -> PressWay:
    """Return which way a press changed conductance.

    Args:
        untouched_V: (n, 104) V of frames before it, n at least 4.
        pressed_V: (m, 104) V of frames during it.
        skin: Whose sheet.

    Raises:
        PressError: The press is not felt, or both ways explain it.
    """
    before = untouched_V.mean(axis=0)
    change = pressed_V.mean(axis=0) / before - 1.0
    sd, shared = noise_of(untouched_V / before - 1.0)
    frames = 1.0 / len(untouched_V) + 1.0 / len(pressed_V)
    error = MODEL_ERROR * np.sqrt(np.mean(change**2))
    covariance = np.diag(frames * sd**2 + error**2 + 1e-12) + frames * shared @ shared.T + DRIFT**2
    touches = build_operators(skin=skin).relative_jacobian @ _neighbourhoods(skin)
    weighed = np.linalg.solve(covariance, touches)
    along, size = change @ weighed, np.einsum("rk,rk->k", touches, weighed)
    gain = along**2 / size
    signs: dict[TouchKind, npt.NDArray[np.bool_]] = {"raise": along > 0.0, "lower": along < 0.0}
    best = {kind: float(np.max(gain, where=there, initial=0.0)) for kind, there in signs.items()}
    kind = max(best, key=lambda one: best[one])
    if best[kind] < MIN_GAIN:
        raise PressError(
            f"the press is not felt: it explains {best[kind]:.1f} of the change in chi-squared, expected {MIN_GAIN:g}; "
            "press harder, well inside the sheet, and hold still"
        )
    log_ratio = (best[kind] - min(best.values())) / 2.0
    if log_ratio < MIN_LOG_RATIO:
        raise PressError(
            f"the press may raise or lower conductance: the log likelihoods differ by {log_ratio:.1f}, expected "
            f"{MIN_LOG_RATIO:g}; press at another place, well inside the sheet"
        )
    at = int(np.argmax(np.where(signs[kind], gain, 0.0)))
    x, y = skin.grid.pixel_centres_mm().reshape(-1, 2)[at]
    return PressWay(kind, log_ratio, (float(x), float(y)))


def _neighbourhoods(skin: Skin) -> Array:
    """Return (pixels, pixels) the share of every pixel in a touch about each."""
    xy = skin.grid.pixel_centres_mm().reshape(-1, 2)
    apart = np.sum((xy[:, None] - xy) ** 2, axis=-1)
    return np.asarray(np.exp(-apart / (2.0 * TOUCH_SIGMA_MM**2)))
