"""Maps of touches by formula: the touched share of every pixel of boxes and discs, anywhere."""

import numpy as np

from eitskin_proto.skin.skin import PAPER

GRID = PAPER.grid
DX, DY = GRID.pixel_mm


def box(x0, y0, x1, y1, grid=GRID):
    """The share of each pixel that a rectangle covers, exactly."""
    (dx, dy), (rows, columns) = grid.pixel_mm, grid.shape
    x = np.clip(np.minimum((np.arange(columns) + 1) * dx, x1) - np.maximum(np.arange(columns) * dx, x0), 0, dx) / dx
    y = np.clip(np.minimum((np.arange(rows) + 1) * dy, y1) - np.maximum(np.arange(rows) * dy, y0), 0, dy) / dy
    return np.outer(y, x)


def square(x, y, side=10.0):
    return box(x - side / 2, y - side / 2, x + side / 2, y + side / 2)


def ellipse(x, y, a, b, angle=0.0, fine=20):
    """The share of each pixel that an ellipse of half axes a and b covers, from fine by fine points a pixel."""
    across = (np.arange(GRID.shape[1] * fine) + 0.5) * DX / fine - x
    along = (np.arange(GRID.shape[0] * fine) + 0.5) * DY / fine - y
    u = across * np.cos(angle) + along[:, None] * np.sin(angle)
    v = -across * np.sin(angle) + along[:, None] * np.cos(angle)
    inside = (u / a) ** 2 + (v / b) ** 2 <= 1.0
    return inside.reshape(GRID.shape[0], fine, GRID.shape[1], fine).mean(axis=(1, 3))


def gaussian(x, y, sigma, peak=1.0):
    centres = GRID.pixel_centres_mm() - (x, y)
    return peak * np.exp(-0.5 * (centres**2).sum(axis=-1) / sigma**2)
