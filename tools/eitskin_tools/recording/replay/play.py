"""A skin that a recording plays: the ordinary runtime on a recorded line.

The bundle, the reference and the solver are those of the recording unless others are named. Each cloud is taken before
the frame that met it first, and a reference that was captured anew takes effect where it did. Electrodes that were
excluded by hand are. What else is wrong with electrodes, drift and the gate's threshold are those of the recording too
(:mod:`eitskin_tools.recording.replay.health`), and so is what hung on the frames before, touched or not, a map that was
kept (:mod:`eitskin_tools.recording.replay.judged`); with another bundle the runtime finds all that out by itself.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from eitskin.health.imputation import Consistency
from eitskin.messaging.streams.measured import Conditions
from eitskin.model.engine import solvers
from eitskin.reference.captured import Reference
from eitskin.skin import Skin
from eitskin_proto.errors import SkinError
from eitskin_tools.recording.bundles import bundle_of, reference_of
from eitskin_tools.recording.layout import RecordingError
from eitskin_tools.recording.replay.health import HealthThen, Noted
from eitskin_tools.recording.replay.judged import JudgedThen
from eitskin_tools.recording.replay.line import RecordedLine
from eitskin_tools.recording.script import Script, Step

NEVER_S = 1e8
"""The recording says when the device idles, nobody asks it to."""


@dataclass(frozen=True, slots=True)
class Manner:
    """How a recording is played."""

    paced: bool = True
    """At the pace at which it came, not as fast as it can be computed."""
    loop: bool = False
    from_s: float | None = None
    to_s: float | None = None
    speed: float = 1.0


class Player:
    """An open skin that plays a recording; leave it with ``close`` or as a context manager.

    Args:
        script: The recording.
        manner: How.
        bundle: A file; None for the bundle that was running, if it is a shipped one.
        solver: The most accurate solver to use; None for the one that was.
        tell: Takes a line on what could not be done.

    Raises:
        SkinError: Bundle, reference or recording cannot be used, with what to do.
        ValueError: The bundle has no such solver.
    """

    def __init__(
        self,
        script: Script,
        manner: Manner = Manner(),
        *,
        bundle: str | Path | None = None,
        solver: str | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._script, self._warn = script, tell
        loaded = bundle_of(script, bundle)
        if solver is None:
            then = script.told("solvers").split()
            solver = then[0] if then and then[0] in solvers(loaded) else None
        first, left_out = _first_known(script, manner)
        if left_out:
            tell(f"the recording does not say what its first {left_out} frames met: they are left out")
        assert first.conditions is not None
        assert first.reference is not None
        began, reference = first.conditions, reference_of(script, first.reference, loaded.skin)
        self._noted: Noted | None = None

        def steps() -> Iterator[Step]:
            self._noted = Noted(script, manner.from_s) if same else None
            return islice(script.steps(manner.from_s, manner.to_s), left_out, None)

        same = loaded.id == script.told("bundle")
        arrays = loaded.consistency_arrays() if same else None
        exclude = tuple(one for one, state, _ in began.electrodes if state == "excluded")
        self._health = None if arrays is None else HealthThen(Consistency.of(arrays), exclude)

        self.line = RecordedLine(
            str(script.path), script.hello, steps, paced=manner.paced, loop=manner.loop, speed=manner.speed
        )
        self.skin = Skin(
            self.line,
            bundle=loaded,
            reference=reference,
            solver=solver,
            skip_unchanged=began.skip_unchanged,
            exclude=exclude,
            idle_after_s=NEVER_S if _idles(script) else None,
        )
        self._reference = began.reference
        if self._health is not None:
            self.skin.pipeline.health = self._health
        self._judged = JudgedThen(self.skin.pipeline) if same else None
        self._use(reference)
        self.line.before = self._before
        self.line.ended = self.skin.stop

    def _before(self, step: Step) -> None:
        """Let hold what holds from a frame on."""
        self._tell(step)
        if step.conditions is None:
            return
        self.skin.loop.source.afterwards.do()  # streams tell of the frame before, by what held for it
        if step.reference is not None and step.conditions.reference != self._reference:
            self._reference = step.conditions.reference
            try:
                self._use(reference_of(self._script, step.reference, self.skin.bundle.skin))
            except SkinError as error:
                self._warn(f"a reference of the recording is left out: {error}")
        self._use_conditions(step.conditions)
        if step.cloud is not None and not (step.cloud.why == "start" and self.skin.pipeline.record.cloud == 0):
            given = step.cloud.why == "given"
            try:
                self.skin.set_cloud(
                    step.cloud.cloud if given else None,
                    step.cloud.predicted if given else None,
                    step.cloud.predicted_flat if given else None,
                )
            except (SkinError, ValueError) as error:
                self._warn(f"cloud {step.cloud.revision} of the recording is left out: {error}")

    def _use(self, reference: Reference) -> None:
        """Hold frames against a recorded reference."""
        self.skin.loop.use(reference)
        self._held_against = self.skin.loop.reference

    def _tell(self, step: Step) -> None:
        """Say of a frame what was found of it then."""
        if self._noted is None:
            return
        noted = self._noted.of(step)
        if self._health is not None:
            self._health.tell(noted.of_health, noted.distance)
        if self._judged is None:
            return
        by_hand = self._health is not None and self._health.by_hand is not None
        if by_hand or self.skin.loop.reference is not self._held_against:
            self._judged.judge()
        else:
            self._judged.go_on_with(step.frame, noted.events, noted.skipped)

    def _use_conditions(self, conditions: Conditions) -> None:
        pipeline = self.skin.pipeline
        if conditions.volts_per_count != pipeline.normaliser.volts_per_count:
            pipeline.normaliser.use_scale(conditions.volts_per_count)
        if self._health is None:
            return
        if self._health.go_on_with(conditions):
            pipeline.maps.change_projection(self._health.projection)
        threshold = conditions.gate_threshold
        if pipeline.gate is not None and threshold is not None and self._health.by_hand is None:
            pipeline.gate.threshold = threshold

    def close(self) -> None:
        """Close the skin; closing twice is fine."""
        self.skin.close()

    def __enter__(self) -> "Player":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _first_known(script: Script, manner: Manner) -> tuple[Step, int]:
    """Return the first frame of which the recording says all that it met, and how many of the part lie before it.

    Raises:
        RecordingError: There is none.
    """
    for before, step in enumerate(script.steps(manner.from_s, manner.to_s)):
        if step.known:
            return step, before
    script.reference()  # says that there is none at all
    raise RecordingError(f"{script.path} does not say what the frames of this part met; choose another by --from, --to")


def _idles(script: Script) -> bool:
    """Whether the device idled at times."""
    return any(status.get("mode_changes") for state in script.states if isinstance(status := state.get("status"), dict))
