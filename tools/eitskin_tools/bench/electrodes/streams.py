"""A sheet that bends while it is touched: its 16 x 16 response solved at a few moments and interpolated between them.

A stream runs from one deformation to the next, of family A or B, while touches come, move over the sheet and in every
second stream lie on an electrode.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.measurement.faults import response_of
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.family import Family, draw
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Disc, Rect, Shape

Array = npt.NDArray[np.float64]

ELEMENT_MM: Final = 4.5
"""Of the streams' mesh: 0.1 s a moment; the reference is of the same mesh."""

STEP_FRAMES: Final = 60
"""Between two moments: 0.3 s at 200 frames/s."""


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """A few solved moments."""

    family: Family
    covering: bool
    """Whether a touch lies on an electrode."""
    responses: Array
    """(moments, 16, 16) ohm."""

    def at(self, frame: int) -> Array:
        """Return the (16, 16) response at a frame; after the last moment it stands still."""
        last = len(self.responses) - 1
        place_, share = divmod(frame / STEP_FRAMES, 1.0)
        first = min(int(place_), last)
        return np.asarray((1.0 - share) * self.responses[first] + share * self.responses[min(first + 1, last)])

    @property
    def frames(self) -> int:
        """Length."""
        return (len(self.responses) - 1) * STEP_FRAMES


def flat_response() -> Array:
    """Return the (16, 16) ohm of the flat, untouched sheet on the streams' mesh."""
    return response_of(factorise_scene(Scene(element_size_mm=ELEMENT_MM)))


def stream(family: Family, number: int, moments: int, *, covering: bool) -> Stream:
    """Return one stream, solved.

    Args:
        family: Of its deformations.
        number: Its seed.
        moments: How many are solved.
        covering: Whether a touch lies on an electrode.
    """
    rng = np.random.default_rng([number, moments, covering])
    first, second = draw(family, 2 * number + 2, 8800)[-2:]
    start, stop = rng.uniform((15, 15), (135, 85)), rng.uniform((15, 15), (135, 85))
    radius = rng.uniform(5.0, 9.0)
    found = []
    for step in range(moments):
        share = step / max(moments - 1, 1)
        x, y = (1.0 - share) * start + share * stop
        shapes: list[Shape] = [Disc(float(x), float(y), float(radius))] if step % 4 else []
        touches = [Touch((shape,)) for shape in shapes]
        if covering:
            touches.append(Touch((_on_electrode(int(rng.integers(N_ELECTRODES)) if step == 0 else number),)))
        bend = _between(first, second, share)
        found.append(response_of(factorise_scene(Scene(bend=bend, touches=tuple(touches), element_size_mm=ELEMENT_MM))))
    return Stream(family, covering, np.array(found))


def _between(first: Bend, second: Bend, share: float) -> Bend:
    mixed: dict[str, Any] = {
        name: (1.0 - share) * getattr(first, name) + share * getattr(second, name)
        for name in ("angle_deg", "axis_deg", "skew", "twist_deg", "stretch_along", "stretch_across", "nonuniformity")
    }
    return Bend(**mixed, bumps_mm=first.bumps_mm if share < 0.5 else second.bumps_mm)


def _on_electrode(electrode: int) -> Rect:
    """Return a touch of 10 to 14 mm that covers an electrode's contact."""
    sheet = nominal_sheet(PAPER)
    piece = next(one for one in place(sheet, nominal_electrodes(PAPER)) if one.electrode == electrode % N_ELECTRODES)
    x0, y0, x1, y1 = piece.patch_mm(sheet, 4.0)
    length, width = sheet.size_mm
    return Rect(max(x0 - 5.0, 0.0), max(y0 - 5.0, 0.0), min(x1 + 5.0, length), min(y1 + 5.0, width))
