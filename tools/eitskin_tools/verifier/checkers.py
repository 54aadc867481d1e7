"""Who explains frames of one shape: by touched units, or by touches anywhere; each as the bundle's labels say."""

from typing import Final, Protocol

import numpy as np

from eitskin.messaging.verified.touch import VerifiedTouch
from eitskin.touches.moments import Finder
from eitskin.touches.surface import Surface
from eitskin_proto.sensor.normalise import inverse_reference
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.verification.free.found import FreeTouch
from eitskin_sim.verification.free.search import FreeVerifier
from eitskin_sim.verification.free.starts import shares_of
from eitskin_sim.verification.unit_sheet import UnitSheet
from eitskin_sim.verification.units import UnitTouch
from eitskin_tools.evaluation.verified.units import noise_shown, unit_heights, unit_starts
from eitskin_tools.verifier.letters import Array, FrameLetter, RestLetter, Setup
from eitskin_tools.verifier.reasons import reason_of

FREE_BUDGET_S: Final = 0.2
"""What a frame of touches anywhere may take, unless told otherwise."""

UNLIKE_ITS_SCAN: Final = (
    "untouched, the sheet does not read as its cloud and reference say; send its cloud, or take a reference anew"
)

Three = tuple[float, float, float]

Verdict = tuple[tuple[float, int, float, bool], tuple[VerifiedTouch, ...], str]
"""chi-squared, degrees of freedom, p-value, flagged; the touches; and why it is flagged, or nothing."""


class CannotVerifyError(Exception):
    """This frame cannot be verified; the text says why."""


class Checker(Protocol):
    """Explains frames of one shape."""

    def check(self, frame: FrameLetter) -> Verdict:
        """Return what explains a frame best.

        Raises:
            CannotVerifyError: Nothing can be said of this one.
        """

    def rest(self, letter: RestLetter) -> str:
        """Take what the untouched sheet reads; return what is wrong with it, nothing where nothing is."""

    @property
    def improves(self) -> bool:
        """Whether the last frame has shown how the model is better made."""

    def improve(self) -> None:
        """Make it so."""


def checker_of(setup: Setup) -> Checker:
    """Return who explains frames of a setup; making the model takes its time.

    Raises:
        MismatchError: The skin is not the one in use.
        ValueError: No model can be made of the cloud, or of the skin.
    """
    return UnitChecker(setup) if setup.labels == "units" else FreeChecker(setup)


class _Shape:
    """What both share: the surface and the reference."""

    def __init__(self, setup: Setup) -> None:
        self.skin: Skin = setup.described()
        self.grid: Grid = self.skin.grid
        self.cloud_mm: Array = np.frombuffer(setup.cloud_mm, dtype="<f4").reshape(self.grid.cloud_shape).astype(float)
        self.reference_V: Array = np.frombuffer(setup.reference_V, dtype="<f8")
        self.usable = inverse_reference(self.reference_V) != 0.0
        self.noise = noise_shown(self.reference_V, np.frombuffer(setup.spread_V, dtype="<f8"))
        self._surface = Surface(self.cloud_mm, self.grid)

    def placed(self, centres_mm: list[tuple[float, float]]) -> list[tuple[Three, Three]]:
        """Return place and normal on the surface of each centre."""
        if not centres_mm:
            return []
        rows = self._surface.at(*zip(*centres_mm, strict=True))
        return [((row[0], row[1], row[2]), (row[3], row[4], row[5])) for row in rows]


class UnitChecker:
    """By touched units, on the reduced model.

    Args:
        setup: Of the shape.
    """

    def __init__(self, setup: Setup) -> None:
        self._shape = _Shape(setup)
        self._budget_s = setup.budget_s or None
        self._sheet = UnitSheet(self._shape.cloud_mm, self._shape.skin)
        self._before: tuple[UnitTouch, ...] = ()

    def check(self, frame: FrameLetter) -> Verdict:
        """Return the touched units that explain a frame best."""
        shape = self._shape
        heights = unit_heights(frame.map.astype(np.float64), shape.grid)
        found = self._sheet.verify(
            frame.change.astype(np.float64),
            shape.reference_V,
            unit_starts(heights),
            shape.noise,
            rows=shape.usable & ~frame.missing,
            budget_s=self._budget_s,
            before=self._before,
            heights=heights,
        )
        self._before = found.touches
        told = found.chi_squared, found.degrees_of_freedom, found.p_value, found.flagged
        return told, self._touches(found.touches), reason_of(found)

    def rest(self, letter: RestLetter) -> str:
        """Learn how the untouched sheet differs from its scan."""
        shape = self._shape
        if not shape.usable.all():
            return ""  # rows that are missing say nothing of the sheet
        known = self._sheet.rest(letter.change, shape.reference_V, shape.noise, letter.frames)
        return "" if known else UNLIKE_ITS_SCAN

    @property
    def improves(self) -> bool:
        """Whether the last frame asks for another model of the sheet."""
        return self._sheet.improves

    def improve(self) -> None:
        """Make it, and keep it if it explains that frame better."""
        self._sheet.improve()

    def _touches(self, units: tuple[UnitTouch, ...]) -> tuple[VerifiedTouch, ...]:
        grid = self._shape.grid
        boxes = [grid.unit_rect_mm(one.unit % grid.units[1], one.unit // grid.units[1]) for one in units]
        centres = [((x0 + x1) / 2.0, (y0 + y1) / 2.0) for x0, y0, x1, y1 in boxes]
        found = []
        for one, (x0, y0, x1, y1), centre, (place, normal) in zip(
            units, boxes, centres, self._shape.placed(centres), strict=True
        ):
            area = (x1 - x0) * (y1 - y0)
            found.append(
                VerifiedTouch(
                    shape="unit", unit=one.unit, centre_mm=centre, centre_error_mm=None, size_mm=(x1 - x0, y1 - y0),
                    size_error_mm=None, angle_rad=0.0, area_mm2=area, area_error_mm2=None, contrast=float(one.contrast),
                    strength_mm2=area * float(np.log(one.contrast)), strength_error_mm2=None, border_mm=0.0,
                    place_mm=place, normal=normal,
                )
            )  # fmt: skip
        return tuple(found)


class FreeChecker:
    """By touches anywhere, on the sparse model.

    Args:
        setup: Of the shape.
    """

    def __init__(self, setup: Setup) -> None:
        self._shape = shape = _Shape(setup)
        self._budget_s = setup.budget_s or FREE_BUDGET_S
        kind: TouchKind = setup.touches  # type: ignore[assignment]  # of a bundle, which was checked
        self._verifier = FreeVerifier(shape.reference_V, shape.noise, kind, shape.skin)
        self._verifier.deform(shape.cloud_mm)
        self._finder = Finder(shape.grid)
        self._last: Array | None = None

    def check(self, frame: FrameLetter) -> Verdict:
        """Return the shapes that explain a frame best.

        Raises:
            CannotVerifyError: Rows are missing, which shapes are not verified without.
        """
        shape = self._shape
        missing = int((frame.missing | ~shape.usable).sum())
        if missing:
            raise CannotVerifyError(f"{missing} of {len(frame.missing)} rows are missing; shapes are verified with all")
        found = self._finder.find(frame.map)
        shares = shares_of(found.pixels, found.touch, found.weights, found.count, shape.grid)
        volts = shape.reference_V * (1.0 + frame.change.astype(np.float64))
        last, self._last = self._last, None  # a frame that fails with it leaves the next one without
        verdict = self._verifier.verify(volts, shares, last, self._budget_s)
        self._last = verdict.pieces if len(verdict.pieces) else None
        placed = shape.placed([one.centre_mm for one in verdict.touches])
        touches = tuple(_free(one, *where) for one, where in zip(verdict.touches, placed, strict=True))
        told = verdict.chi_squared, verdict.degrees_of_freedom, verdict.p_value, verdict.flagged
        return told, touches, reason_of(verdict)

    def rest(self, letter: RestLetter) -> str:
        """Learn how the untouched sheet differs from its scan."""
        shape = self._shape
        if not shape.usable.all():
            return ""  # no frame is verified without all rows
        known = self._verifier.rest(shape.reference_V * (1.0 + letter.change), letter.frames)
        return "" if known else UNLIKE_ITS_SCAN

    @property
    def improves(self) -> bool:
        """Return False: this verifier makes its model anew amid a frame."""
        return False

    def improve(self) -> None:
        """Do nothing."""


def _free(one: FreeTouch, place: Three, normal: Three) -> VerifiedTouch:
    return VerifiedTouch(
        shape=one.shape, unit=None, centre_mm=one.centre_mm, centre_error_mm=one.centre_error_mm, size_mm=one.size_mm,
        size_error_mm=one.size_error_mm, angle_rad=float(np.radians(one.angle_deg)), area_mm2=one.area_mm2,
        area_error_mm2=one.area_error_mm2, contrast=one.contrast, strength_mm2=one.strength_mm2,
        strength_error_mm2=one.strength_error_mm2, border_mm=one.border_mm, place_mm=place,
        normal=normal, angle_error_rad=None if one.angle_error_deg is None else float(np.radians(one.angle_error_deg)),
        area_range_mm2=one.area_range_mm2, contrast_range=one.contrast_range,
        size_contrast_correlation=one.size_contrast_correlation,
    )  # fmt: skip
