"""Refuses bends that no sheet can follow: turned inside out, bent tighter than its thickness, or through itself.

A sheet of thickness t meets itself where two points far apart along it come nearer in space than t; a turn as tight as
the sheet allows brings points at pi t / 2 so near, so "far" is 2 pi t.

Most sheets need not be looked at point by point. Let x(p) be the sheet rolled and twisted, p in its stretched plane. If
for every direction d of the plane there is a unit vector u with u . dx/dd >= m on the whole sheet, the line from p to q
gives ::

    |x(q) - x(p)| >= u . (x(q) - x(p)) = integral of u . dx/dd >= m |q - p|

so points farther than 2 pi t come no nearer than t wherever m > 1 / (2 pi). u is the mean of dx/dd over the sheet.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from eitskin_sim.arrays import Array
from eitskin_sim.scene.bend import RollFrame, first_form, frame_at, heights, second_form, surface
from eitskin_sim.scene.parts import Bend, SceneError, Sheet, Touch
from eitskin_sim.scene.soft_touch import dents_of

MIN_CLEARANCE: Final = 0.3
"""Least m: 1 / (2 pi) is 0.16, and as much again for what lies between the directions and points that are looked at."""

DIRECTIONS: Final = 64
"""How many directions of the plane are looked at."""


def check_bend(bend: Bend, sheet: Sheet, touches: Sequence[Touch] = (), *, apart: bool = True) -> None:
    """Raise SceneError where a bend cannot be: it turns the sheet inside out, or folds the sheet through itself.

    Args:
        bend: The bend.
        sheet: What is bent.
        touches: Whose dents press it in.
        apart: Whether parts that are far from each other along the sheet are compared, which takes most of the time.
    """
    least = bend.stretch_along - abs(bend.nonuniformity)
    if least <= 0.0:
        raise SceneError(
            f"scene.bend.nonuniformity is {bend.nonuniformity:g}; it must be below stretch_along = "
            f"{bend.stretch_along:g} in size, or the sheet folds over itself in its plane"
        )
    if not bend.angle_deg and not bend.twist_deg and not bend.bumps_mm:
        return
    dents = dents_of(touches)
    frame = _check_curvature(bend, sheet, dents)
    if apart and (bend.bumps_mm or dents or not _runs_ahead(frame)):
        _check_apart(bend, sheet, dents)


def _samples(sheet: Sheet, pitch_mm: float) -> tuple[Array, float]:
    length, width = sheet.size_mm
    pitch = max(pitch_mm, float(np.sqrt(length * width / 60_000)))
    nx, ny = int(np.ceil(length / pitch)) + 1, int(np.ceil(width / pitch)) + 1
    x, y = np.meshgrid(np.linspace(0.0, length, nx), np.linspace(0.0, width, ny))
    return np.stack([x.ravel(), y.ravel()], axis=-1), pitch


def _check_curvature(bend: Bend, sheet: Sheet, dents: Sequence[Touch]) -> RollFrame:
    """Return the sheet's frame, without its bumps and dents, at the points that were looked at."""
    xy, _ = _samples(sheet, min(sheet.size_mm) / 50)
    frame = frame_at(bend, sheet, xy, placed=False)
    first = first_form(frame, frame.d_s, frame.d_w)
    if np.any(np.linalg.det(first) <= 1e-12):
        raise SceneError(
            "scene.bend turns the sheet over itself: its area stretch falls to 0; it must be above: lower twist_deg"
        )
    shape = np.linalg.solve(first, second_form(frame))
    mean, gauss = np.trace(shape, axis1=1, axis2=2) / 2, np.linalg.det(shape)
    spread = np.sqrt(np.maximum(mean**2 - gauss, 0.0))
    height, _ = heights(bend, xy, dents)
    offset = 1.0 - np.maximum(height * (mean + spread), height * (mean - spread))
    if offset.min() <= 0.0:
        raise SceneError(
            f"{_raised(bend, dents)} folds the sheet through itself: height times curvature reaches "
            f"{1.0 - offset.min():.3g}; it must be below 1: lower the {'dent' if dents else 'bump'} or angle_deg"
        )
    bump = max((abs(height) / sigma**2 for _, _, height, sigma in bend.bumps_mm), default=0.0)
    curvature = float(np.max(np.abs(mean) + spread)) + bump
    half = sheet.thickness_mm / 2
    if curvature * half >= 1.0:
        raise SceneError(
            f"scene.bend folds the sheet: its radius of curvature is {1.0 / curvature:.3g} mm; it must be above "
            f"half the thickness, {half:g} mm"
        )
    return frame


def _raised(bend: Bend, dents: Sequence[Touch]) -> str:
    """Return what of a scene raises its surface along the normal."""
    keys = ["scene.bend.bumps_mm"] * bool(bend.bumps_mm) + ["dent_mm of scene.touches"] * bool(dents)
    return " with ".join(keys)


def _runs_ahead(frame: RollFrame) -> bool:
    """Return whether every line of the plane runs ahead along one direction of space for as long as it is."""
    angle = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    cos, sin = np.cos(angle), np.sin(angle)
    ahead = cos[:, None] * frame.d_s.mean(axis=0) + sin[:, None] * frame.d_w.mean(axis=0)
    length = np.linalg.norm(ahead, axis=1, keepdims=True)
    if length.min() < MIN_CLEARANCE:
        return False
    ahead /= length
    return bool((frame.d_s @ ahead.T * cos + frame.d_w @ ahead.T * sin).min() >= MIN_CLEARANCE)


def _check_apart(bend: Bend, sheet: Sheet, dents: Sequence[Touch] = ()) -> None:
    """Compare distances in space with distances along the sheet, on samples half a thickness apart."""
    xy, pitch = _samples(sheet, sheet.thickness_mm / 2)
    points = surface(bend, sheet, xy, dents)
    near = max(sheet.thickness_mm, pitch)
    stretch = min(1.0, bend.stretch_across, bend.stretch_along - abs(bend.nonuniformity))
    far = 2.0 * np.pi * near / stretch
    pairs = cKDTree(points).query_pairs(near, output_type="ndarray")
    apart = np.hypot(*(xy[pairs[:, 0]] - xy[pairs[:, 1]]).T)
    folded = apart > far
    if not folded.any():
        return
    pair = pairs[np.argmax(np.where(folded, apart, 0.0))]
    (xa, ya), (xb, yb) = xy[pair]
    gap = float(np.linalg.norm(points[pair[0]] - points[pair[1]]))
    raise SceneError(
        f"scene.bend folds the sheet through itself: flat points ({xa:.0f}, {ya:.0f}) and ({xb:.0f}, {yb:.0f}) come "
        f"within {gap:.2g} mm; they must stay more than {near:g} mm apart: lower angle_deg (it is {bend.angle_deg:g}), "
        f"skew, twist_deg{', dent_mm' if dents else ''} or the bumps"
    )
