"""What a fit says of every touch: where, how large, how strong, how sure; and the map of all.

Size and contrast answer nearly alike: a smaller touch that conducts better reads like a larger one that does not. What
is known well is their product, the strength: log contrast times area. So a touch says the correlation of the two, and
how far area and contrast may go along each other while the fit stays within two standard deviations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.gap import gap_mm
from eitskin_sim.scene.touch_table import RECTANGLE, Array, cover, pixel_lines
from eitskin_sim.shapes.parameters import (
    ANGLE,
    COUNT,
    HALF_LENGTH,
    HALF_WIDTH,
    LOG_CONTRAST,
    X,
    Y,
    areas_mm2,
    strengths_mm2,
)
from eitskin_sim.verification.chi_squared import LEVEL, p_value
from eitskin_sim.verification.free.fit import Fit
from eitskin_sim.verification.free.prior.joints import Joints, bodies
from eitskin_sim.verification.verdict import Verdict

LEAST_SEEN: Final = 1e-12
"""Of the curvature along what is known best: what is known less counts as that."""

WITHIN: Final = 2.0
"""Standard deviations of the ranges."""


Likely = tuple[tuple[float, Array], ...]
"""Shares of belief, 1 in all, and (n, 8) touches; the fit's own first."""


@dataclass(frozen=True, slots=True)
class FreeTouch:
    """One touch off the unit grid; errors are standard errors, of the present fit and the prior together."""

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
    """None where the angle was not fitted: such a touch lies along the sheet."""


@dataclass(frozen=True, slots=True)
class FreeVerdict(Verdict[FreeTouch]):
    """One frame, explained by shapes off the unit grid."""

    pieces: Array = field(default_factory=lambda: np.zeros((0, 8)))
    """(n, 8) the touches as a table: the next frame's first start."""
    trail: tuple[str, ...] = ()
    """Which other sheets were gone on with."""
    likely: Likely = ()
    """Shares of belief, and touches as they are drawn: ``pieces``, and those of other contrasts that the data allow."""
    scatter: Array = field(default_factory=lambda: np.zeros((0, 0, COUNT)))
    """(k, n, 7) independent ways in which the parameters of ``pieces`` may be off, of one standard deviation each."""
    joints: Joints = ()
    """Which of ``pieces`` hang together, as the network shows them and the frame allows."""

    @property
    def bodies(self) -> int:
        """Return how many touches there are, shapes that hang together counted once."""
        return bodies(len(self.pieces), self.joints)

    def map(self, grid: Grid = PAPER.grid) -> Array:
        """Return the (rows, columns) map: what depends on a contrast that nobody knows is drawn in part."""
        return drawn(self.likely, grid)

    @property
    def flagged(self) -> bool:
        """Whether physics cannot explain the frame by these touches, or they are ``unfinished``."""
        return self.unfinished or self.p_value < self.level


def touches_of(fit: Fit, scatter: Array, others: Sequence[Array] = ()) -> tuple[FreeTouch, ...]:
    """Return what a fit says of every touch.

    Args:
        fit: The fit.
        scatter: (k, n, 7) in which ways it may be off, as :func:`scatter_of` says.
        others: (n, 8) touches each, of other contrasts that explain the frame as well: ranges reach as far as they do.
    """
    if not len(fit.pieces):
        return ()
    own = fit.errors[2]
    ways = scatter[:, own]
    covariance = ways.T @ ways
    number = np.full(own.shape, -1)
    number[own] = np.arange(own.sum())
    areas, strengths = areas_mm2(fit.pieces), strengths_mm2(fit.pieces)
    found = []
    for row, piece in enumerate(fit.pieces):
        at = number[row]
        sd = np.sqrt(np.diag(covariance))
        log_area = np.zeros(len(covariance))
        log_area[at[HALF_LENGTH]], log_area[at[HALF_WIDTH]] = 2.0 / piece[3], 2.0 / piece[4]
        log_contrast = np.zeros(len(covariance))
        log_contrast[at[LOG_CONTRAST]] = 1.0
        strength = areas[row] * (np.log(piece[6]) * log_area + log_contrast)
        area_sd, contrast_sd, strength_sd = (
            float(np.sqrt(max(one @ covariance @ one, 0.0))) for one in (log_area, log_contrast, strength)
        )
        both = float(log_area @ covariance @ log_contrast) / max(area_sd * contrast_sd, 1e-300)
        found.append(
            FreeTouch(
                shape="rectangle" if piece[0] == RECTANGLE else "ellipse",
                centre_mm=(float(piece[1]), float(piece[2])),
                centre_error_mm=(float(sd[at[X]]), float(sd[at[Y]])),
                size_mm=(float(piece[3]), float(piece[4])),
                size_error_mm=(2.0 * float(sd[at[HALF_LENGTH]]), 2.0 * float(sd[at[HALF_WIDTH]])),
                angle_deg=float(piece[5]) % 180.0,
                area_mm2=float(areas[row]),
                area_error_mm2=float(areas[row] * area_sd),
                contrast=float(piece[6]),
                contrast_range=_reaching(_range(float(piece[6]), contrast_sd), [one[row, 6] for one in others]),
                border_mm=float(piece[7]),
                strength_mm2=float(strengths[row]),
                strength_error_mm2=strength_sd,
                size_contrast_correlation=both,
                area_range_mm2=_reaching(_range(float(areas[row]), area_sd), [areas_mm2(one)[row] for one in others]),
                angle_error_deg=float(np.degrees(sd[at[ANGLE]])) if at[ANGLE] >= 0 else None,
            )
        )
    return tuple(found)


def _range(value: float, sd: float) -> tuple[float, float]:
    factor = float(np.exp(min(WITHIN * sd, 30.0)))
    return value / factor, value * factor


def _reaching(span: tuple[float, float], others: Sequence[float]) -> tuple[float, float]:
    return float(min([span[0], *others])), float(max([span[1], *others]))


def scatter_of(fit: Fit) -> Array:
    """Return (k, n, 7) independent ways in which a fit's parameters may be off, each of one standard deviation."""
    own = np.zeros((0, 0)) if not len(fit.pieces) else fit.errors[2]
    found = np.zeros((int(own.sum()), len(fit.pieces), COUNT))
    if len(found):
        by = fit.errors[1]
        size, way = np.linalg.eigh(by.T @ by)
        found[:, own] = (way / np.sqrt(np.maximum(size, LEAST_SEEN * size.max()))).T
    return found


def degrees_of_freedom(fit: Fit) -> int:
    """Return how many of the frame's rows are left once what is free has been fitted, the prior counted."""
    rows = len(fit.residual)
    if not len(fit.pieces):
        return rows
    _, by, _ = fit.errors
    whole, data = by.T @ by, by[:rows].T @ by[:rows]
    return rows - round(float(np.trace(np.linalg.solve(whole + 1e-9 * np.diag(np.diag(whole) + 1e-9), data))))


def p_of(fit: Fit) -> float:
    """Return the chance that right touches leave as much of a frame as a fit does, or more."""
    return p_value(fit.chi_squared, max(degrees_of_freedom(fit), 1))


def explained(fit: Fit) -> bool:
    """Return whether a fit leaves nothing to look for."""
    return p_of(fit) > 5.0 * LEVEL


def map_of(pieces: Array, grid: Grid = PAPER.grid) -> Array:
    """Return the (rows, columns) touched share of every pixel; what touches share counts once, as nearly as it can."""
    lines = pixel_lines(grid)
    total = np.zeros(grid.shape)
    for number, piece in enumerate(pieces):
        rows, columns, share = cover(piece, *lines)
        shared = 1.0 if _overlaps(pieces, number) else 0.0
        total[rows, columns] += share * (1.0 - shared * total[rows, columns])
    return np.asarray(np.clip(total, 0.0, 1.0))


def drawn(likely: Likely, grid: Grid) -> Array:
    """Return the (rows, columns) map of touches by their shares of belief."""
    return np.asarray(sum(share * map_of(pieces, grid) for share, pieces in likely))


def _overlaps(pieces: Array, number: int) -> bool:
    """Return whether a touch meets one before it by more than a border."""
    before = pieces[:number]
    return bool(len(before)) and bool((gap_mm(np.tile(pieces[number], (number, 1)), before) < -0.5).any())
