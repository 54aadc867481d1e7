"""The touches of frames that came without: listed here, so that the runtime need not list them for a picture's sake.

Listing touches takes the frame loop a tenth of a millisecond of each of 200 frames a second, before the frame goes out.
A page draws 30 of them a second at most. So the viewer asks for maps alone, and lists their touches by the runtime's
own rule. While somebody else has the runtime list them, frames bring touches along, and these are shown.
"""

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.messaging.frame import Frame
from eitskin.touches.surface import Surface
from eitskin.touches.touch import LAYOUT, unpack_touches
from eitskin.touches.watch import TouchWatch
from eitskin_proto.skin.grid import Grid

NOWHERE: Final = (0.0, 0.0, 0.0)
"""The normal of a touch whose surface is not known yet: who draws it places it on the surface that is drawn."""


class OwnTouches:
    """Lists the touches of one frame after another.

    Args:
        grid: Of the skin; frames with other maps are left as they are.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid, self._watch = grid, TouchWatch(grid)
        self._flat = Surface(grid.flat_cloud_mm(), grid)
        self._surfaces: dict[tuple[str, int], Surface] = {}
        self._run = ""

    def use(self, run: str, revision: int, cloud_mm: npt.NDArray[np.floating]) -> None:
        """Place touches on a surface, of frames that were computed with it; may be called from another thread.

        Args:
            run: Of the runtime.
            revision: As frames name it in ``cloud``.
            cloud_mm: (3, rows, columns) mm.
        """
        if cloud_mm.shape[1:] == self._grid.shape:
            self._surfaces = {(run, revision): Surface(cloud_mm, self._grid)}

    def listed(self, frame: Frame) -> Frame:
        """Return a frame with its touches: those that it brought, or else our own."""
        if frame.touch_list is not None or frame.map.shape != self._grid.shape or frame.run != self._run:
            self._watch.forget()
            self._run = frame.run
        if frame.touch_list is not None or frame.map.shape != self._grid.shape:
            return frame
        known = self._surfaces.get((frame.run, frame.cloud))
        surface = known or self._flat
        values = frame.map.reshape(-1) if frame.map.any() else None
        raw, events, more = self._watch.look(values, (frame.solver, frame.map_sequence), surface, frame.device_us)
        found = unpack_touches(raw, LAYOUT.size, events, more)
        if known is None and frame.cloud:
            found = replace(found, touches=tuple(replace(one, normal=NOWHERE) for one in found.touches))
        return replace(frame, touch_list=found)
