"""A reference that another thread requests and waits for while frames continue.

The thread waits on a ``SimpleQueue``, which a signal handler may fill; an ``Event`` that the interrupted thread is
setting at that moment would deadlock.
"""

from queue import Empty, SimpleQueue

from eitskin.errors import BadReference, SkinError
from eitskin.reference.builder import ReferenceBuilder
from eitskin.reference.captured import Reference
from eitskin.reference.judged import ReferenceChecks
from eitskin_proto.wire.messages import Hello


class Recapture:
    """A request that the frame loop fills and the requesting thread waits for.

    Args:
        builder: Builder for the requested number of frames.
        checks: What the reference is compared with.
        force: Whether it is accepted whatever the findings.
    """

    __slots__ = ("_checks", "_force", "_outcome", "builder", "settled")

    def __init__(self, builder: ReferenceBuilder, checks: ReferenceChecks, *, force: bool) -> None:
        self.builder, self._checks, self._force = builder, checks, force
        self._outcome: SimpleQueue[Reference | SkinError] = SimpleQueue()
        self.settled = False
        """It has an outcome, whether or not that was waited for already."""

    def finish(self, hello: Hello) -> Reference:
        """Return the reference of the frames that were taken.

        Raises:
            BadReference: The sheet was bent, touched or moving, or nothing is connected.
        """
        return self.builder.finish(hello, self._checks, force=self._force)

    def settle(self, outcome: Reference | SkinError) -> None:
        """Say which reference is in use now, or why there is no new one; safe in a signal handler. The first counts."""
        self.settled = True
        self._outcome.put(outcome)

    def wait(self, seconds: float) -> Reference | None:
        """Return the reference that is in use; None if it was not settled in time.

        Raises:
            BadReference: It was not taken.
        """
        try:
            outcome = self._outcome.get(timeout=seconds)
        except Empty:
            return None
        if isinstance(outcome, SkinError):
            raise outcome
        return outcome

    def under_way(self) -> BadReference:
        """Return the error of another one, which must wait for this."""
        return BadReference(f"{self.builder.taken} of {self.builder.frames} frames of another reference are in")

    def too_few(self) -> BadReference:
        """Return the error of frames that did not come."""
        return BadReference(f"only {self.builder.taken} of {self.builder.frames} frames for the reference came")
