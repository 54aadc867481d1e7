"""Explains the frames of one shape of the sheet: by touched units, or by touches anywhere, as the labels say."""

from typing import Any, Final

import numpy as np

from eitskin.messaging.streams.verified import DENTED, FITTED, TIME, UNEXPLAINED, VerifiedTouch
from eitskin.touches.surface import Surface
from eitskin_proto.sensor.normalise import inverse_reference
from eitskin_proto.skin.toml import parse
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.scene.family import is_family
from eitskin_sim.surface.predict import flat_voltages, predict
from eitskin_sim.verification.shape_verdict import ShapeTouch, ShapeVerdict
from eitskin_sim.verification.snapped_units import UnitTouch
from eitskin_sim.verification.verdict import Verdict as Found
from eitskin_tools.evaluation.verified.solver import MapVerifier, noise_shown
from eitskin_tools.verifier.followed import FollowedTouches
from eitskin_tools.verifier.letters import Array, BaselineLetter, FrameLetter, Setup, Shape

SCAN_MISMATCH: Final = (
    "the untouched sheet does not match its cloud and reference: send its cloud, or capture a new reference"
)

SHAPE_UNKNOWN: Final = (
    "the untouched sheet has no shape that its skin's [deformations] allow: send its cloud, or capture a new reference"
)

NOT_FLAT: Final = "the untouched sheet is not flat: start without --cloud flat, or capture a new reference"

Three = tuple[float, float, float]

Verdict = tuple[tuple[float, int, float, bool], tuple[VerifiedTouch, ...], str]
"""chi-squared, degrees of freedom, p-value, flagged; the touches; and what is to be said of it, or nothing."""


class CannotVerifyError(Exception):
    """This frame cannot be verified; the text says why."""


class Checker:
    """Explains frames of one shape; making its model takes some seconds.

    Args:
        setup: Of the shape.

    Raises:
        ValueError: No model can be made of the cloud, or of the skin.
    """

    def __init__(self, setup: Setup) -> None:
        skin, cloud_mm, reference_V = parse(setup.skin), setup.cloud_mm.astype(float), setup.reference_V
        self._skin, self._grid, self._budget_s = skin, skin.grid, setup.budget_s
        self._usable = inverse_reference(reference_V) != 0.0
        self._reference_V: Array = np.where(self._usable, reference_V, 0.0)
        self._surface = Surface(cloud_mm, skin.grid)
        touches: TouchKind = setup.touches  # type: ignore[assignment]  # of a bundle, which was checked
        noise = noise_shown(reference_V, setup.spread_V, setup.shared_V)
        self._verifier = MapVerifier(self._reference_V, noise, setup.labels, touches, skin)
        self._followed = FollowedTouches()
        self._is_guess, self.why = setup.is_guess, ""
        """The latter: what is wrong with the cloud."""
        shapes = self._verifier.shapes
        try:
            shapes.deform(cloud_mm, is_guess=setup.is_guess, is_certain=setup.is_certain)
        except ValueError as error:
            if setup.is_certain or not is_family(skin.deformations):
                raise
            self.why = f"no model of the cloud ({error}), so the shape is fitted to frames: send another cloud"
            self._is_guess = True
            shapes.deform(skin.grid.flat_cloud_mm().astype(float), is_guess=True)
        self._mismatch = NOT_FLAT if setup.is_certain else SHAPE_UNKNOWN if self._is_guess else SCAN_MISMATCH

    def check(self, frame: FrameLetter) -> Verdict:
        """Return what explains a frame best.

        Raises:
            CannotVerifyError: Nothing can be said of this one.
        """
        image = frame.map.astype(np.float64).reshape(self._grid.shape)
        if why := self._verifier.refused(image):
            raise CannotVerifyError(why)
        volts = self._reference_V * (1.0 + frame.change.astype(np.float64))
        rows = self._usable & ~frame.missing
        verdict = self._verifier.verify(volts, image, self._budget_s, rows, frame.fused)
        found: Any = verdict.touches
        if isinstance(verdict, ShapeVerdict) and not verdict.flagged:
            found = self._followed.follow(found, frame.device_us, frame.fused)
        touches = tuple(self._message_of(one) for one in found)
        told = verdict.chi_squared, verdict.degrees_of_freedom, verdict.p_value, verdict.flagged
        return told, touches, reason_of(verdict) or (FITTED if self._verifier.shapes.is_fitted else "")

    def learn_baseline(self, letter: BaselineLetter) -> str:
        """Learn from what the untouched sheet reads; return what is wrong with it, nothing where nothing is."""
        if not self._usable.all():
            return ""  # a sheet is known by all its rows
        shapes = self._verifier.shapes
        known = shapes.use_untouched(self._reference_V * (1.0 + letter.change), letter.frames)
        return self.why if known and (self._is_guess or not shapes.is_fitted) else self._mismatch

    def another_shape(self) -> Shape | None:
        """Return the shape that frames show, on which later touches are placed; None if it is as before."""
        if (cloud_mm := self._verifier.shapes.another_cloud()) is None:
            return None
        self._surface = Surface(cloud_mm, self._grid)
        return cloud_mm, predict(cloud_mm, self._skin), flat_voltages(self._skin)

    def _message_of(self, one: UnitTouch | ShapeTouch) -> VerifiedTouch:
        if isinstance(one, UnitTouch):
            x0, y0, x1, y1 = self._grid.unit_rect_mm(one.unit % self._grid.units[1], one.unit // self._grid.units[1])
            place, normal = self._on_surface((x0 + x1) / 2.0, (y0 + y1) / 2.0)
            return _unit(one, (x0, y0, x1, y1), place, normal)
        return _shape(one, *self._on_surface(*one.centre_mm))

    def _on_surface(self, x_mm: float, y_mm: float) -> tuple[Three, Three]:
        """Return place and normal on the surface of a centre."""
        row = self._surface.at((x_mm,), (y_mm,))[0]
        return (row[0], row[1], row[2]), (row[3], row[4], row[5])


def _unit(one: UnitTouch, box_mm: tuple[float, float, float, float], place: Three, normal: Three) -> VerifiedTouch:
    x0, y0, x1, y1 = box_mm
    area = (x1 - x0) * (y1 - y0)
    return VerifiedTouch(
        shape="unit", unit=one.unit, centre_mm=((x0 + x1) / 2.0, (y0 + y1) / 2.0), centre_error_mm=None,
        size_mm=(x1 - x0, y1 - y0), size_error_mm=None, angle_rad=0.0, area_mm2=area, area_error_mm2=None,
        contrast=float(one.contrast), strength_mm2=area * float(np.log(one.contrast)), strength_error_mm2=None,
        border_mm=0.0, place_mm=place, normal=normal,
    )  # fmt: skip


def _shape(one: ShapeTouch, place: Three, normal: Three) -> VerifiedTouch:
    return VerifiedTouch(
        shape=one.shape, unit=None, centre_mm=one.centre_mm, centre_error_mm=one.centre_error_mm, size_mm=one.size_mm,
        size_error_mm=one.size_error_mm, angle_rad=float(np.radians(one.angle_deg)), area_mm2=one.area_mm2,
        area_error_mm2=one.area_error_mm2, contrast=one.contrast, strength_mm2=one.strength_mm2,
        strength_error_mm2=one.strength_error_mm2, border_mm=one.border_mm, place_mm=place,
        normal=normal, angle_error_rad=None if one.angle_error_deg is None else float(np.radians(one.angle_error_deg)),
        area_range_mm2=one.area_range_mm2, contrast_range=one.contrast_range,
        size_contrast_correlation=one.size_contrast_correlation,
    )  # fmt: skip


def reason_of(verdict: Found[Any]) -> str:
    """Return why a verdict is flagged, in the words of the message; nothing where it is not."""
    if not verdict.flagged:
        return ""
    if verdict.unfinished:
        return TIME
    return UNEXPLAINED if verdict.p_value < verdict.level else DENTED
