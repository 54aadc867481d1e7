"""The bent sheet as a map from the flat sheet, with its metric in closed form.

Three maps follow each other. (1) Stretch in the plane: x -> xi(x) with d xi/dx = stretch_along + a cos(2 pi x / L), and
y -> stretch_across * y, both about the sheet's middle. (2) Roll and twist: s runs across the axis and w along it, and

    r(s, w) = c(s) + w d(s),   c' = T(s),   d = cos(phi) b + sin(phi) n,   kappa(s) = angle / S * (1 + skew * 2 s / S)

with S the stretched sheet's extent across the axis, (T, b, n) the cylinder's frame, and phi = twist * s / S. (3) Bumps
raise the surface along its normal by h(x, y); so do the dents of touches, which only a touched scene's metric has.

The metric of (2) in (s, w) is diag((1 - w kappa sin phi)^2 + (w phi')^2, 1): without twist it is the identity, so any
angle, axis and skew leave the metric of (1) exactly as it is. A layer that keeps its volume conducts
K = sigma t0 g^-1 in flat coordinates, and so such a bend changes no voltage, to the last bit.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.scene.parts import Bend, Sheet, Touch
from eitskin_sim.scene.soft_touch import dent_heights, dents_of


@dataclass(frozen=True, slots=True)
class RollFrame:
    """The twisted roll at some points: positions and derivatives in the plane's frame, (n, 3) each."""

    position: Array
    d_s: Array
    d_w: Array
    normal: Array
    second_ss: Array
    """(n,) the second fundamental form's ss component; ww is zero."""
    second_sw: Array
    jacobian: Array
    """(n, 2, 2) d(s, w) / d(x, y)."""


def surface(bend: Bend, sheet: Sheet, xy_mm: Array, dents: Sequence[Touch] = ()) -> Array:
    """Return the (n, 3) mm positions of flat points (n, 2); a flat scene gives (x, y, 0)."""
    xy = np.asarray(xy_mm, dtype=np.float64)
    frame = frame_at(bend, sheet, xy)
    height, _ = heights(bend, xy, dents)
    return frame.position + height[:, None] * frame.normal


def metric(bend: Bend, sheet: Sheet, xy_mm: Array, dents: Sequence[Touch] = ()) -> Array:
    """Return the (n, 3) first fundamental form E, F, G at flat points (n, 2): (1, 0, 1) where nothing is stretched."""
    xy = np.asarray(xy_mm, dtype=np.float64)
    if not bend.twist_deg and not bend.bumps_mm and not dents:
        found = np.zeros((len(xy), 3))
        found[:, 0] = _stretch_x(bend, sheet, xy[:, 0])[1] ** 2
        found[:, 2] = bend.stretch_across**2
        return found
    frame = frame_at(bend, sheet, xy, placed=False)
    height, slope = heights(bend, xy, dents)
    first = first_form(frame, frame.d_s, frame.d_w)
    if bend.bumps_mm or dents:
        second = second_form(frame)
        shape = np.linalg.solve(first, second)
        shrink = np.eye(2) - height[:, None, None] * shape
        first = np.swapaxes(shrink, 1, 2) @ first @ shrink + slope[:, :, None] * slope[:, None, :]
    return np.stack([first[:, 0, 0], first[:, 0, 1], first[:, 1, 1]], axis=-1)


def bend_metric(bend: Bend, sheet: Sheet, touches: Sequence[Touch] = ()) -> Callable[[Array], Array]:
    """Return the metric of a bend, and of the dents of touches, as a function of flat points alone."""
    dents = dents_of(touches)
    return lambda xy_mm: metric(bend, sheet, xy_mm, dents)


def _stretch_x(bend: Bend, sheet: Sheet, x_mm: Array) -> tuple[Array, Array]:
    """Return xi, centred, and its derivative."""
    length = sheet.size_mm[0]
    phase = 2.0 * np.pi * x_mm / length
    xi = bend.stretch_along * (x_mm - length / 2) + bend.nonuniformity * length / (2.0 * np.pi) * np.sin(phase)
    return xi, bend.stretch_along + bend.nonuniformity * np.cos(phase)


def heights(bend: Bend, xy_mm: Array, dents: Sequence[Touch] = ()) -> tuple[Array, Array]:
    """Return the height (n,) of bumps and dents together, along the normal, and its gradient (n, 2)."""
    height, slope = bump_heights(bend, xy_mm)
    if not dents:
        return height, slope
    deep, steep = dent_heights(dents, xy_mm)
    return height + deep, slope + steep


def bump_heights(bend: Bend, xy_mm: Array) -> tuple[Array, Array]:
    """Return the height (n,) and its gradient (n, 2)."""
    height, slope = np.zeros(len(xy_mm)), np.zeros((len(xy_mm), 2))
    for x, y, top, sigma in bend.bumps_mm:
        offset = xy_mm - np.array([x, y])
        here = top * np.exp(-0.5 * np.einsum("na,na->n", offset, offset) / sigma**2)
        height += here
        slope -= here[:, None] * offset / sigma**2
    return height, slope


def first_form(frame: RollFrame, d_s: Array, d_w: Array) -> Array:
    """Return the (n, 2, 2) first fundamental form in x, y."""
    tangents = np.stack([d_s, d_w], axis=1)
    inner = tangents @ np.swapaxes(tangents, 1, 2)
    return np.swapaxes(frame.jacobian, 1, 2) @ inner @ frame.jacobian


def second_form(frame: RollFrame) -> Array:
    """Return the (n, 2, 2) second fundamental form in x, y; the plane map's second derivatives are tangent."""
    form = np.zeros((len(frame.second_ss), 2, 2))
    form[:, 0, 0] = frame.second_ss
    form[:, 0, 1] = form[:, 1, 0] = frame.second_sw
    return np.swapaxes(frame.jacobian, 1, 2) @ form @ frame.jacobian


def frame_at(bend: Bend, sheet: Sheet, xy_mm: Array, *, placed: bool = True) -> RollFrame:
    """Return the stretched, rolled and twisted sheet, before its bumps, at flat points (n, 2).

    Without ``placed`` the positions are left at zero: a metric needs none, and they cost four fifths of the time.
    """
    length, width = sheet.size_mm
    axis, angle, twist = np.deg2rad([bend.axis_deg, bend.angle_deg, bend.twist_deg])
    cos_axis, sin_axis = np.cos(axis), np.sin(axis)
    xi, stretch = _stretch_x(bend, sheet, xy_mm[:, 0])
    eta = bend.stretch_across * (xy_mm[:, 1] - width / 2)
    s = cos_axis * xi + sin_axis * eta
    w = -sin_axis * xi + cos_axis * eta
    extent = abs(cos_axis) * bend.stretch_along * length + abs(sin_axis) * bend.stretch_across * width

    u = s / extent
    turned = angle * (u + bend.skew * u**2)
    curvature = angle / extent * (1.0 + 2.0 * bend.skew * u)
    curvature_rate = angle / extent * 2.0 * bend.skew / extent
    rate = twist / extent
    cos_p, sin_p = np.cos(rate * s), np.sin(rate * s)

    zero = np.zeros_like(s)
    tangent = np.stack([np.cos(turned), zero, np.sin(turned)], axis=-1)
    across = np.stack([zero, zero + 1.0, zero], axis=-1)
    upward = np.stack([-np.sin(turned), zero, np.cos(turned)], axis=-1)
    ruling = cos_p[:, None] * across + sin_p[:, None] * upward
    swing = cos_p[:, None] * upward - sin_p[:, None] * across
    lean = 1.0 - w * curvature * sin_p
    d_s = lean[:, None] * tangent + (w * rate)[:, None] * swing
    size = np.hypot(lean, w * rate)
    normal = (lean[:, None] * swing - (w * rate)[:, None] * tangent) / size[:, None]
    second = (
        (lean * curvature)[:, None] * upward
        - (w * (curvature_rate * sin_p + 2.0 * curvature * rate * cos_p))[:, None] * tangent
        - (w * rate**2)[:, None] * ruling
    )
    mixed = rate * swing - (curvature * sin_p)[:, None] * tangent
    turn = np.array([[cos_axis, sin_axis, 0.0], [-sin_axis, cos_axis, 0.0], [0.0, 0.0, 1.0]])
    centre = np.array([length / 2, width / 2, 0.0])
    jacobian = np.empty((len(s), 2, 2))
    jacobian[:, 0, 0], jacobian[:, 0, 1] = cos_axis * stretch, sin_axis * bend.stretch_across
    jacobian[:, 1, 0], jacobian[:, 1, 1] = -sin_axis * stretch, cos_axis * bend.stretch_across
    return RollFrame(
        position=(_roll(s, u, angle, bend.skew) + w[:, None] * ruling) @ turn + centre
        if placed
        else np.zeros_like(ruling),
        d_s=d_s @ turn,
        d_w=ruling @ turn,
        normal=normal @ turn,
        second_ss=np.einsum("na,na->n", second, normal),
        second_sw=np.einsum("na,na->n", mixed, normal),
        jacobian=jacobian,
    )


def _roll(s: Array, u: Array, angle: float, skew: float) -> Array:
    """Return c(s), the integral of the tangent from 0, by Gauss's rule: 32 points for a phase below 10 rad."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    at = u[:, None] * (nodes + 1.0) / 2
    turned = angle * (at + skew * at**2)
    half = s / 2
    return np.stack([half * (np.cos(turned) @ weights), np.zeros_like(s), half * (np.sin(turned) @ weights)], axis=-1)
