"""What a subscriber asks for, as topics (:mod:`eitskin.messaging.publish` has the list), and what a message is then."""

from dataclasses import dataclass
from typing import Self

from eitskin.messaging.frame import (
    EVERY_FRAME,
    FIRST_BYTE,
    TOUCH_FIRST_BYTE,
    Frame,
    patient_topics,
    unpack_frame,
)
from eitskin.messaging.regions import ALWAYS, EVERYWHERE, TOUCHES, UNCHANGED, WHOLE, Region
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin


class NotAsked(Exception):  # noqa: N818 -- nothing went wrong
    """A frame without the touches that were asked for."""


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a subscriber asks for."""

    region: Region
    """What of the map is needed."""
    grid: Grid | None
    """Whose pixels the region means; None without one."""
    topics: tuple[bytes, ...]
    """To subscribe to, in this order: the frames last, when all that is needed has been said."""
    touches: bool
    """Whether a frame without touches is of no use."""
    maps: bool
    each: bool
    """Whether frames that are not returned must be looked at too: a later one may lack the map that they have."""

    @classmethod
    def of(
        cls,
        region_mm: tuple[float, float, float, float] | None,
        skin: Skin | None,
        *,
        skip_unchanged: bool,
        touches: bool,
        maps: bool,
        patient: bool,
    ) -> Self:
        """Return what the arguments of :class:`eitskin.Subscription` mean.

        Raises:
            ValueError: The region is not on the sheet, or something is asked of maps that are not wanted.
        """
        if not maps and (region_mm is not None or skip_unchanged):
            raise ValueError("maps=False takes no maps at all: leave region_mm and skip_unchanged out")
        grid = None if region_mm is None else (skin or PAPER).grid
        region = EVERYWHERE if region_mm is None or grid is None else Region.from_mm(*region_mm, grid)
        first = FIRST_BYTE if maps else TOUCH_FIRST_BYTE
        frames = patient_topics(first) if patient else (first,)
        said: tuple[bytes, ...] = ()
        if maps and (skip_unchanged or touches or patient):
            said = (WHOLE, UNCHANGED if skip_unchanged else ALWAYS)
            said += (TOUCHES,) if touches else ()
        elif maps:
            frames = (EVERY_FRAME,)
        return cls(region, grid, said + frames, touches or not maps, maps, skip_unchanged)

    def frame(self, message: bytes, received_ns: int, known: Frame | None) -> Frame:
        """Return the frame of a message; arguments as of :func:`eitskin.messaging.frame.unpack_frame`.

        Raises:
            NotAsked: It has no touches, and they were asked for.
            FrameError: As of ``unpack_frame``.
        """
        frame = unpack_frame(message, received_ns, known)
        if self.touches and frame.touch_list is None:
            raise NotAsked
        return frame
