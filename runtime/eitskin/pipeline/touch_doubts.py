"""Notices touches that the bundle does not know: for seconds nothing is on the map, or the other kind fits better.

A touch that lowers conductance by a factor reads nearly like the reciprocal of one that raises it by as much. So a
network that learned one kind shows the other where V / V_pred is replaced by its reciprocal. And the projection, whose
values have a sign, is largest with the sign of the touch, as far as V_pred is known. Once a second ::

    own, other = touched pixels of the frame's map and of its reciprocal's
    turned      the projection's largest value < OTHER_SHARE of that of the other sign, or
                other > 2 own + OTHER_PIXELS, unless the other sign's largest value < OTHER_SHARE of that of its own
    doubtful    turned, or own has nothing that is listed as a touch

Nearly all touches of the other kind are turned on a flat sheet, and most on a bent one without a cloud; of the bundle's
own kind hardly any. Doubtful looks count up, others down; ``LOOKS`` are an event.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.frame_record import FrameRecord
from eitskin.model.buffers import Buffers
from eitskin.model.bundle import Bundle
from eitskin.pipeline.map_source import MapSource
from eitskin.touches.pieces import HALF
from eitskin.touches.tracking import BIRTH

LOOK_US: Final = 1_000_000
LOOKS: Final = 3
"""Three seconds."""

OTHER_PIXELS: Final = 5
OTHER_SHARE: Final = 0.5


class TouchDoubts:
    """Looks at touched frames now and then.

    Args:
        bundle: Whose touches are known.
        maps: Computes maps.
        buffers: Has the frame and its map.
        record: Of the frame.
    """

    def __init__(self, bundle: Bundle, maps: MapSource, buffers: Buffers, record: FrameRecord) -> None:
        self._other = {"raise": "lower", "lower": "raise", "both": ""}[bundle.touch_kind]
        self._projection = bundle.tikhonov() if self._other and "tikhonov.npy" in bundle.files else None
        self._maps, self._buffers, self._record = maps, buffers, record
        self._change, self._map = buffers.change.copy(), buffers.map.copy()
        self._looked_us = self._doubtful = self._turned = 0
        self.found = ""
        """``lower`` or ``raise`` where such touches explain the frames, ``unlisted`` where none does; else empty."""

    @property
    def due(self) -> bool:
        """Whether it is time for a look."""
        record = self._record
        passed = not 0 <= record.device_us - self._looked_us < LOOK_US
        return passed and (record.touched or self._doubtful > 0) and not record.idle and self._maps.can_overrule

    def look(self) -> str:
        """Look at the frame in hand, which is published already, and return an event for the next one, or ""."""
        self._looked_us = self._record.device_us
        doubtful, turned = self._judge() if self._record.touched else (False, False)
        self._doubtful = min(max(self._doubtful + (1 if doubtful else -1), 0), LOOKS)
        self._turned = min(max(self._turned + (1 if turned else -1), 0), LOOKS)
        if self._doubtful == 0:
            self.found = ""
        if self._doubtful < LOOKS or self.found:
            return ""
        self.found = self._other if 2 * self._turned >= LOOKS else "unlisted"
        return f"touches:{self.found}"

    def _judge(self) -> tuple[bool, bool]:
        """Return whether the frame is doubtful, and whether touches of the other kind explain it."""
        change, values, predicted = self._buffers.change, self._buffers.map, self._buffers.log_predicted
        infer = self._maps.engines[self._maps.budget.engine].infer
        self._change[:], self._map[:] = change, values
        if self._record.map_is_zero:
            infer()
        own, largest, turned = np.count_nonzero(values >= HALF), float(values.max()), False
        if self._other:
            ratio = np.maximum(1.0 + change, 1e-2) * np.exp(-predicted)
            change[:] = np.exp(predicted) / ratio - 1.0
            infer()
            shows_more = bool(np.count_nonzero(values >= HALF) > 2 * own + OTHER_PIXELS)
            turned = self._is_turned(ratio[0] - 1.0, shows_more)
        change[:], values[:] = self._change, self._map
        return turned or largest < BIRTH, turned

    def _is_turned(self, change: npt.NDArray[np.float32], shows_more: bool) -> bool:
        """Return whether (rows,) dV against V_pred is of the other kind, of which the map shows more or does not."""
        if self._projection is None:
            return shows_more
        values = self._projection @ change
        raised, lowered = float(values.max()), -float(values.min())
        own, other = (raised, lowered) if self._other == "lower" else (lowered, raised)
        return own < OTHER_SHARE * other or (shows_more and OTHER_SHARE * own < other)
