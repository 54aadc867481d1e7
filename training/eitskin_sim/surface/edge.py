"""Finds the edge of the points along one side of a sheet: the most likely polynomial, despite blur and stray points.

Points lie on the sheet with rho per square millimetre and each coordinate is off by about sigma, so a point at the
distance x outwards has the density rho Phi((e - x) / sigma), e(a) being the side. The polynomial e that makes the
points most likely, the empty places beyond the side included, is the greatest of ::

    sum_i log(eps + (1 - eps) Phi((e(a_i) - x_i) / sigma))  -  integral rho e da  -  penalty on the bends of e

It uses the few points at the step and no others: sqrt(sigma / rho) is its error for a side of 1 mm, whereas counting in
a band of width w has sqrt(w / rho). eps, the share of stray points, keeps one of them from pulling the side out. sigma
is the most likely of a few. The greatest of n draws lies short of the end of their interval by 1/n of it, and so does a
likelihood's: that is added.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtr

from eitskin_sim.arrays import Array
from eitskin_sim.surface.rows import find_rows

DEGREE: Final = 5
"""Degree of a side's polynomial."""

BEND_MM: Final = (1e3, 1e3, 0.2, 0.1, 0.08, 0.06)
"""Usual size of a side's Legendre coefficients; charts of twisted, dented sheets have larger ones, so it is a Cauchy's
law that they are drawn from."""

STRAY_DENSITY: Final = 0.003
"""eps, the density of stray points beyond the side over that on the sheet."""

STRIP_MM: Final = 8.0
"""Width of the strips that the density is taken in."""

DENSITY_MM: Final = (1.0, 10.0)
"""Between these depths inside the side the density is taken."""

MIN_DENSITY_RATIO: Final = 0.4
"""A strip with less than this part of the median density is a notch: the side runs through it unseen."""

REACH_MM: Final = (3.0, 6.0)
"""Points from this far inside the side to this far outside take part."""

BLURS_MM: Final = (1.0, 0.4, 0.2, 0.1, 0.05)
"""Values of sigma, of which the most likely that is no less than the points' noise is taken; each starts from the last
one's side."""

MIN_SIGMA_RATIO: Final = 0.05
"""No sigma is less than this part of the points' mean distance."""

LARGEST_STEP_MM: Final = 0.3
"""A Newton step is cut to this, or to two sigma."""

NEWTON_STEPS: Final = 11
"""Newton steps for each sigma."""


@dataclass(frozen=True, slots=True)
class Edge:
    """One side of the sheet."""

    coefficients: Array
    """Of powers of the place along the side / 100 mm."""
    sigma_mm: float
    """Root mean square, along the side, of what its place is uncertain by."""
    blur_mm: float
    """How soft the points' end is."""
    rows_mm: float
    """Distance of the points' rows, if they lie in rows along the side, which then is their outermost; else 0."""


def fit_edge(along: Array, out: Array, span: tuple[float, float], start: Array, noise_mm: float) -> Edge:
    """Return where points end.

    Args:
        along: (n,) place along the side in mm.
        out: (n,) distance outwards in mm, from any line.
        span: Where along the side the sheet begins and ends.
        start: Coefficients of a first guess, as in :class:`Edge`.
        noise_mm: Standard deviation of the points.

    Raises:
        ValueError: The side is nowhere seen.
    """
    low, high = span
    depth = np.asarray(np.polynomial.polynomial.polyval(along / 100.0, start) - out)
    on = (along >= low) & (along < high) & (depth > -REACH_MM[1]) & (depth < DENSITY_MM[1])
    depth, out = depth[on], out[on]
    at = 2.0 * (along[on] - low) / (high - low) - 1.0
    n = max(int((high - low) / STRIP_MM), 4)
    strip = ((at + 1.0) * (0.5 * n)).astype(np.intp)
    width = (high - low) / n
    density = np.bincount(strip[depth > DENSITY_MM[0]], minlength=n) / (width * (DENSITY_MM[1] - DENSITY_MM[0]))
    usual = float(np.median(density))
    filled = density > MIN_DENSITY_RATIO * usual
    if filled.sum() < n // 2 or usual == 0.0:
        raise ValueError(f"a side of the sheet has points in only {filled.sum()} of {n} strips along it")
    near = (depth < REACH_MM[0]) & filled[strip]
    middle = (2.0 * np.arange(n) + 1.0) / n - 1.0
    mass = np.where(filled, density * width, 0.0) @ _legendre(middle)
    design = _legendre(at)
    guess = np.zeros(DEGREE + 1)
    guess[:4] = np.linalg.lstsq(
        _legendre(middle)[:, :4], np.polynomial.polynomial.polyval(_along(middle, span), start), rcond=None
    )[0]
    least = max(noise_mm, MIN_SIGMA_RATIO / float(np.sqrt(usual)))
    found = []
    for blur in (*(blur for blur in BLURS_MM if blur > 1.3 * least), least):
        guess, value, information = _most_likely(design[near], out[near], mass, guess, blur)
        found.append((value, blur, guess, information))
    _, blur, guess, information = max(found, key=lambda item: item[0])
    guess = guess.copy()
    whole = information + np.diag(_stiffness(guess))
    variance = np.diag(np.linalg.inv(whole))
    rows = find_rows(design @ guess - out, usual)
    if rows is None:
        per_mm = float(mass[0])  # points in a strip of 1 mm along the whole side
        free = max(float(np.trace(np.linalg.solve(whole, information))), 1.0)
        guess[0] += free / per_mm * (0.37 + 0.63 / (1.0 + 4.0 * blur * per_mm / free))
    else:
        guess[0] -= rows[0]
    places = np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
    powers = np.linalg.solve(np.vander(_along(places, span), increasing=True), _legendre(places) @ guess)
    sigma = float(np.sqrt(np.sum(variance / (2.0 * np.arange(DEGREE + 1) + 1.0))))
    return Edge(np.asarray(powers, dtype=np.float64), sigma, blur, 0.0 if rows is None else rows[1])


def _along(at: Array, span: tuple[float, float]) -> Array:
    """Places along the side / 100 mm of places from -1 to 1."""
    return np.asarray((span[0] + (at + 1.0) * (0.5 * (span[1] - span[0]))) / 100.0)


def _stiffness(guess: Array) -> Array:
    """(DEGREE + 1,) second derivatives of a parabola that lies under the logarithm of Cauchy's law and touches it."""
    return np.asarray(2.0 / (np.square(BEND_MM) + guess**2))


def _legendre(at: Array) -> Array:
    return np.asarray(np.polynomial.legendre.legvander(at, DEGREE))


def _most_likely(design: Array, out: Array, mass: Array, guess: Array, blur: float) -> tuple[Array, float, Array]:
    """Coefficients, the logarithm of their likelihood, and its second derivatives."""
    best, best_value, best_information = guess, -np.inf, np.zeros((len(guess),) * 2)
    step: Array = np.zeros(len(guess))
    for _ in range(NEWTON_STEPS):
        value, slope, information = _likelihood(design, out, mass, best + step, blur)
        value -= float(np.log1p(np.square((best + step) / BEND_MM)).sum())
        if value < best_value:
            step = 0.5 * step
            if np.abs(step).sum() < 1e-4:
                break
            continue
        rise = value - best_value
        best, best_value, best_information = best + step, value, information
        if rise < 1e-3:
            break
        stiff = _stiffness(best)
        step = np.asarray(np.linalg.solve(information + np.diag(stiff), slope - stiff * best), dtype=np.float64)
        step *= min(1.0, max(2.0 * blur, LARGEST_STEP_MM) / max(float(np.abs(step).sum()), 1e-12))
    return best, best_value, best_information


def _likelihood(design: Array, out: Array, mass: Array, guess: Array, blur: float) -> tuple[float, Array, Array]:
    z = (design @ guess - out) / blur
    here = STRAY_DENSITY + (1.0 - STRAY_DENSITY) * ndtr(z)
    hazard = (1.0 - STRAY_DENSITY) * np.exp(-0.5 * z * z) / (np.sqrt(2.0 * np.pi) * here)
    curve = np.maximum(hazard * (z + hazard), 0.0)
    value = float(np.log(here).sum() - mass @ guess)
    slope = design.T @ hazard / blur - mass
    return value, slope, (design * (curve / blur**2)[:, None]).T @ design
