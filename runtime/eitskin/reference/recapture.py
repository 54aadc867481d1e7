"""A reference that another thread asked for while frames go on, and waits for."""

import threading

from eitskin.errors import BadReference, SkinError
from eitskin.reference.captured import ReferenceBuilder


class Recapture:
    """What the frame loop fills and the asking thread waits for.

    Args:
        frames: Of the reference.

    Raises:
        ValueError: Fewer than 2 frames.
    """

    __slots__ = ("_done", "_error", "builder")

    def __init__(self, frames: int) -> None:
        self.builder = ReferenceBuilder(frames)
        self._done = threading.Event()
        self._error: SkinError | None = None

    def settle(self, error: SkinError | None = None) -> None:
        """Say that the reference is in use, or why it is not."""
        self._error = error
        self._done.set()

    def wait(self, seconds: float) -> bool:
        """Return whether it was settled in time.

        Raises:
            BadReference: It was not taken.
        """
        if not self._done.wait(seconds):
            return False
        if self._error is not None:
            raise self._error
        return True

    def too_few(self) -> BadReference:
        """Return the error of frames that did not come."""
        return BadReference(f"only {self.builder.taken} of {self.builder.frames} frames for the reference came")
