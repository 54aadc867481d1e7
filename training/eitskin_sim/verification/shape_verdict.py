"""The verdict of a fit: place, size, strength and errors of every touch, and the map.

Size and contrast have nearly the same effect: a smaller touch that conducts better reads like a larger one that does
not. Only their product is known well, the strength: log contrast times area. So a touch states the correlation of the
two, and their ranges within two standard deviations of the fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array
from eitskin_sim.scene.touch_table import RECTANGLE
from eitskin_sim.shapes.parameters import (
    ANGLE,
    HALF_LENGTH,
    HALF_WIDTH,
    LOG_CONTRAST,
    N_PARAMETERS,
    X,
    Y,
    areas_mm2,
    strengths_mm2,
)
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.fit import Fit
from eitskin_sim.verification.network_map import map_of
from eitskin_sim.verification.verdict import Verdict

Likely = tuple[tuple[float, Array], ...]
"""Shares of belief, 1 in all, and (n, 8) touches; the fit's own first."""


@dataclass(frozen=True, slots=True)
class ShapeTouch:
    """One touch anywhere; errors are standard errors, of the present fit and the prior together."""

    shape: str
    """"rectangle" or "ellipse"."""
    centre_mm: tuple[float, float]
    centre_error_mm: tuple[float, float]
    size_mm: tuple[float, float]
    """Length and width."""
    size_error_mm: tuple[float, float]
    angle_deg: float
    area_mm2: float
    area_error_mm2: float
    contrast: float
    contrast_range: tuple[float, float]
    """Two standard errors of its logarithm either way."""
    border_mm: float
    """Width of the graded border; 0 is sharp."""
    strength_mm2: float
    """Log contrast times area; below 0 where a press lowers conductance."""
    strength_error_mm2: float
    size_contrast_correlation: float
    """Of log area and log contrast: near -1, the data tell only their product."""
    area_range_mm2: tuple[float, float]
    """Two standard errors of its logarithm either way, contrast changing along."""
    angle_error_deg: float | None = None
    """None where the angle was not fitted: such a touch is aligned with the sheet."""


@dataclass(frozen=True, slots=True)
class ShapeVerdict(Verdict[ShapeTouch]):
    """One frame, explained by shapes."""

    pieces: Array = field(default_factory=lambda: np.zeros((0, 8)))
    """(n, 8) the touches as a table."""
    likely: Likely = ()
    """Shares of belief, and touches as they are drawn: ``pieces``, and those of other contrasts that the data allow."""

    def map(self, grid: Grid = PAPER.grid) -> Array:
        """Return the (rows, columns) map: parts that depend on an unknown contrast have reduced values."""
        return np.asarray(sum(share * map_of(pieces, grid) for share, pieces in self.likely))

    @property
    def flagged(self) -> bool:
        """Whether physics cannot explain the frame by these touches, knows its sheet too badly, or time ended."""
        return self.unfinished or self.on_dented_sheet or self.p_value < self.level


def touches_of(fit: Fit, scatter: Array, others: Sequence[Array] = ()) -> tuple[ShapeTouch, ...]:
    """Return the verdict of a fit on every touch.

    Args:
        fit: The fit.
        scatter: (k, n, 7) in which ways it may be off, as :func:`scatter_of` says.
        others: (n, 8) touches each, of other contrasts that explain the frame as well: ranges reach as far as they do.
    """
    if not len(fit.pieces):
        return ()
    areas, strengths = areas_mm2(fit.pieces), strengths_mm2(fit.pieces)
    found = []
    for row, piece in enumerate(fit.pieces):
        off = scatter[:, row]
        sd = np.sqrt(np.square(off).sum(axis=0))
        log_area = 2.0 * (off[:, HALF_LENGTH] / piece[3] + off[:, HALF_WIDTH] / piece[4])
        log_contrast = off[:, LOG_CONTRAST]
        area_sd, contrast_sd = float(np.linalg.norm(log_area)), float(np.linalg.norm(log_contrast))
        strength_sd = float(np.linalg.norm(areas[row] * (np.log(piece[6]) * log_area + log_contrast)))
        found.append(
            ShapeTouch(
                shape="rectangle" if piece[0] == RECTANGLE else "ellipse",
                centre_mm=(float(piece[1]), float(piece[2])),
                centre_error_mm=(float(sd[X]), float(sd[Y])),
                size_mm=(float(piece[3]), float(piece[4])),
                size_error_mm=(2.0 * float(sd[HALF_LENGTH]), 2.0 * float(sd[HALF_WIDTH])),
                angle_deg=float(piece[5]) % 180.0,
                area_mm2=float(areas[row]),
                area_error_mm2=float(areas[row] * area_sd),
                contrast=float(piece[6]),
                contrast_range=_range(float(piece[6]), contrast_sd, [one[row, 6] for one in others]),
                border_mm=float(piece[7]),
                strength_mm2=float(strengths[row]),
                strength_error_mm2=strength_sd,
                size_contrast_correlation=float(log_area @ log_contrast) / max(area_sd * contrast_sd, 1e-300),
                area_range_mm2=_range(float(areas[row]), area_sd, [areas_mm2(one)[row] for one in others]),
                angle_error_deg=float(np.degrees(sd[ANGLE])) if fit.turning else None,
            )
        )
    return tuple(found)


def _range(value: float, log_sd: float, others: Sequence[float]) -> tuple[float, float]:
    """Return how far a value may go either way, and as far as others do."""
    factor = float(np.exp(min(c.RANGE_SD * log_sd, 30.0)))
    return float(min([value / factor, *others])), float(max([value * factor, *others]))


def scatter_of(fit: Fit) -> Array:
    """Return (k, n, 7) independent ways in which a fit's parameters may be off, each of one standard deviation."""
    if not len(fit.pieces):
        return np.zeros((0, 0, N_PARAMETERS))
    _, by, fitted = fit.linear_nearby
    size, way = np.linalg.eigh(by.T @ by)
    found = np.zeros((len(size), *fitted.shape))
    found[:, fitted] = (way / np.sqrt(np.maximum(size, c.MIN_CURVATURE_SHARE * size.max()))).T
    return found
