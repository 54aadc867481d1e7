"""Computes a recording again from its first frame to its last, and compares the maps.

Each frame is computed by the runtime's own pipeline, with the recorded reference, cloud and conditions. With the
recorded bundle the pipeline takes its decisions from the recording (:mod:`eitskin.pipeline.recorded`), and the maps
equal the published ones bit by bit. Another bundle uses its own gate, and another solver makes its own maps; these are
compared with the maps of the recorded bundle.

A recording keeps a digest of each published map. If only noise had changed, the runtime published the earlier map
again: then the digest is that of the earlier frame, which ``map_seq`` names.
"""

import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from eitskin.errors import MismatchError
from eitskin.health.imputation import Consistency
from eitskin.messaging.regions import whole
from eitskin.messaging.streams.measured import WireFrame
from eitskin.model.bundle import Bundle
from eitskin.model.engine import SCALED, SMALLEST_MAP, default_solver
from eitskin.model.geometry import GeometryGraph
from eitskin.model.taught import TaughtField
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.pipeline.recorded import RecordedHealth
from eitskin.touches.surface import Surface
from eitskin_proto.files.arrays import save_arrays
from eitskin_proto.files.writing import replacing
from eitskin_tools.recording.codec import digest_of
from eitskin_tools.recording.layout import RecordingError
from eitskin_tools.recording.script import Script, Step, bundle_of, reference_of

NO_SOLVER: Final = "none"
"""The solver of a map that is 0."""

VERIFIED: Final = "verified"
"""The solver that checks the network's touches by the forward model."""

ALL_SOLVERS_NS: Final = 1 << 62
"""A latency budget that every solver meets: with one, the pipeline has all solvers of the bundle."""


@dataclass(frozen=True, slots=True, eq=False)
class ComputedFrame:
    """What became of one frame."""

    map: npt.NDArray[np.float32]
    """(rows, columns); zero where nothing touches."""
    touched: bool
    solver: str
    gate_logit: float | None = None
    """As it came out now; None where there is no gate."""
    judged: Any = None
    """A :class:`~eitskin_tools.evaluation.verified.solver.MapVerdict`; None where physics is not asked."""
    is_whole: bool = True
    """The runtime computed the whole map then; earlier releases could compute some rectangles alone."""
    fused: int = 1
    """Frames that the map rests on."""


class Rerun:
    """Computes one frame after another.

    Args:
        script: The recording.
        bundle: The solvers.
        solver: Of the bundle, for every frame; None for the one that made each frame's map, or with another bundle the
            one that it would use by itself.

    Raises:
        BundleError: The bundle cannot be used.
        ValueError: It has no such solver.
    """

    def __init__(self, script: Script, bundle: Bundle, solver: str | None = None) -> None:
        self._script, self._bundle = script, bundle
        self.as_recorded = bundle.id == script.head_text("bundle")
        """The bundle is the one that was running."""
        self.bundle_id = bundle.id
        arrays = bundle.consistency_arrays()
        self._health = None if arrays is None else RecordedHealth(Consistency.of(arrays))
        self._pipeline = Pipeline(bundle, script.hello, ALL_SOLVERS_NS, health=self._health, skip_unchanged=True)
        self._graph = GeometryGraph(bundle)
        self._pipeline.start_with(self._graph.geometry(None, None, 0))
        self._solvers = {NO_SOLVER, *(engine.name for engine in self._pipeline.engines)}
        if solver is not None:
            self._check(solver)
        self._solver = solver if solver is not None or self.as_recorded else default_solver(bundle)
        self._nothing = np.zeros(bundle.skin.grid.shape, dtype=np.float32)
        self._whole = whole(bundle.skin.grid.shape)
        self._regions = self._whole
        self._ready, self._number = False, -1

    def _check(self, solver: str) -> None:
        if solver not in self._solvers:
            names = ", ".join([*(engine.name for engine in self._pipeline.engines), VERIFIED])
            raise ValueError(f"solver {solver!r} does not exist; expected one of {names}")

    @property
    def field(self) -> TaughtField | None:
        """What finds touches that were learned from presses; None in other bundles."""
        return self._pipeline.field

    @property
    def surface(self) -> Surface:
        """The surface in use."""
        return self._pipeline.buffers.surface

    @property
    def change(self) -> npt.NDArray[np.float32]:
        """(104,) dV of the frame whose map came last, as its solver saw it; valid until the next one."""
        return np.asarray(self._pipeline.buffers.change[0])

    @property
    def missing(self) -> npt.NDArray[np.bool_]:
        """(104,) which of its rows were filled in from the others."""
        nothing = np.zeros(self._pipeline.buffers.change.size, dtype=np.bool_)
        return nothing if self._health is None else self._health.electrodes.missing

    def compute(self, step: Step, *, every: bool = True) -> ComputedFrame | None:
        """Compute a frame; None if the recording lacks its reference, or it was withheld.

        Args:
            step: The frame, and what changed before it.
            every: Whether the map is wanted also where that of an earlier frame was published.

        Raises:
            SkinError: Reference or cloud cannot be used with this bundle.
        """
        self._change(step)
        frame, pipeline = step.frame, self._pipeline
        record, decided = pipeline.record, pipeline.decisions
        if not self._ready or not step.known or frame.withheld or frame.seq is None:
            return None
        if frame.frame is None or frame.frame != self._number + 1:
            pipeline.maps.start_mean()  # frames are lacking that it may need
        self._number = -1 if frame.frame is None else frame.frame
        if not pipeline.load_recorded(frame.payload, frame.seq):  # of the idle mode: there is no map
            return ComputedFrame(self._nothing, frame.touched, NO_SOLVER)
        decided.touched = frame.touched if self.as_recorded or pipeline.gate is None else None
        decided.inferred_untouched, decided.keeps_map, decided.fused = False, frame.map_seq != frame.seq, frame.fused
        decided.solver = self._solver or frame.solver
        self._check(decided.solver)
        # where the map of an earlier frame was published, its own is asked for
        wanted = decided.solver != NO_SOLVER and (every or not decided.keeps_map)
        if not pipeline.compute(decided.solver != NO_SOLVER):
            return ComputedFrame(self._nothing, False, NO_SOLVER)
        if wanted and decided.keeps_map and record.touched and not pipeline.maps.infer(decided.solver):
            return ComputedFrame(self._nothing, False, NO_SOLVER)
        logit = None if pipeline.gate is None else record.gate_logit
        if not record.touched or decided.solver == NO_SOLVER:
            return ComputedFrame(self._nothing, record.touched, NO_SOLVER, logit)
        found = self._map() if wanted else self._nothing
        whole, fused = self._regions == self._whole, 1 if decided.keeps_map else record.fused
        return ComputedFrame(found, True, decided.solver, logit, is_whole=whole, fused=fused)

    def _map(self) -> npt.NDArray[np.float32]:
        """Return a copy of the map of the frame in hand, as far as the runtime computed it then."""
        values: npt.NDArray[np.float32] = self._pipeline.buffers.map[0].reshape(self._nothing.shape)
        if self._regions == self._whole:
            return np.array(values)
        kept = np.zeros_like(values)
        for region in self._regions:
            kept[region.slices] = values[region.slices]
        largest = float(kept.max())
        scaled = self._pipeline.record.solver in SCALED and largest > SMALLEST_MAP
        return np.divide(kept, np.float32(largest)) if scaled else kept

    def _change(self, step: Step) -> None:
        """Use what changed before a frame."""
        pipeline = self._pipeline
        if step.reference is not None:
            pipeline.use_reference(reference_of(self._script, step.reference, self._bundle.skin))
            self._ready = True
        if (cloud := step.cloud) is not None:
            if cloud.cloud.shape != (expected := self._bundle.skin.grid.cloud_shape):
                hint = "name a bundle of the skin that was recorded"
                raise MismatchError("cloud: shape", found=cloud.cloud.shape, expected=expected, hint=hint)
            given = cloud.cloud if cloud.why in ("given", "fitted") else None
            pipeline.start_with(self._graph.geometry(given, cloud.log_predicted, cloud.revision))
        if (conditions := step.conditions) is not None:
            pipeline.normaliser.use_scale(conditions.volts_per_count)
            self._regions = conditions.regions
            if self._health is not None and self._health.use_recorded(
                conditions.drift, conditions.electrodes, conditions.missing_rows
            ):
                pipeline.leave_out_missing()
            if self.as_recorded and pipeline.gate is not None and conditions.gate_threshold is not None:
                pipeline.gate.threshold = conditions.gate_threshold


MAX_DIGESTS: Final = 256
"""Digests of maps that a later frame may have been published with: a map is computed again at least every 100
frames."""

UNKNOWN_REASONS: Final = {
    "no_conditions": "came before the file has their reference and cloud",
    "frame_missing": "have the map of a frame that the file lacks or does not describe",
    "earlier": "rest on frames from before the recording: a taught bundle averages them and follows the sheet",
    "region": "differ in a last bit at most: an earlier release computed some rectangles of them alone",
}
"""Reasons why equality with a published map is unknown, with their texts."""

TOUCHED_LEVEL: Final = 0.5
"""A pixel above it is touched."""


@dataclass(slots=True)
class Equality:
    """Counts published maps that come out the same."""

    follows: bool = False
    """Maps rest on earlier frames, which a recording may lack."""
    published: int = 0
    """Frames that were published, with a digest."""
    equal: int = 0
    unknown_why: Counter[str] = field(default_factory=Counter)
    """Frames with unknown equality, by a key of ``UNKNOWN_REASONS``."""
    differing: Counter[str] = field(default_factory=Counter)
    """Why the others are not equal: ``gate``, its value is another one; ``map``."""
    first_differing: int | None = None
    """``seq`` of the first of them."""
    _digests: OrderedDict[int, str] = field(default_factory=OrderedDict)
    _zero: str = ""

    @property
    def unknown(self) -> int:
        """Frames with unknown equality."""
        return self.unknown_why.total()

    def _keep(self, sequence: int, found: ComputedFrame) -> None:
        self._set_zero_digest(found)
        self._digests[sequence] = self._zero if found.solver == NO_SOLVER else digest_of(found.map)
        if len(self._digests) > MAX_DIGESTS:
            self._digests.popitem(last=False)

    def add(self, step: Step, found: ComputedFrame | None) -> None:
        """Hold a frame's digest, if it was published, against what was computed.

        Args:
            step: The frame.
            found: What it came to; None where nothing could be computed.
        """
        frame = step.frame
        rests = found is not None and (self.follows or found.fused == frame.fused)  # on the same frames
        if found is not None and rests and frame.seq is not None and frame.map_seq == frame.seq:
            self._keep(frame.seq, found)
        if (digest := step.note.get("digest")) is not None:
            self._compare(frame, digest, found)

    def _compare(self, frame: WireFrame, digest: str, found: ComputedFrame | None) -> None:
        self.published += 1
        if found is not None:
            self._set_zero_digest(found)
        ours = (
            self._zero
            if frame.solver == NO_SOLVER
            else self._digests.get(-1 if frame.map_seq is None else frame.map_seq)
        )
        if found is None or ours is None:
            self.unknown_why["no_conditions" if found is None else "frame_missing"] += 1
        elif (same_gate := found.gate_logit in (None, frame.gate_logit)) and ours == digest:
            self.equal += 1
        elif self.follows:
            self.unknown_why["earlier"] += 1
        elif not same_gate:
            self._differs("gate", frame)
        elif not found.is_whole:
            self.unknown_why["region"] += 1
        else:
            self._differs("map", frame)

    def _set_zero_digest(self, found: ComputedFrame) -> None:
        self._zero = self._zero or digest_of(np.zeros_like(found.map))

    def _differs(self, why: str, frame: WireFrame) -> None:
        self.differing[why] += 1
        if self.first_differing is None:
            self.first_differing = frame.seq

    def fields(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "published": self.published,
            "equal": self.equal,
            "unknown": self.unknown,
            "unknown_why": dict(self.unknown_why),
            "differing": dict(self.differing),
            "first_differing": self.first_differing,
        }


def unknown_clause(found: Mapping[str, Any]) -> str:
    """Return a clause about maps with unknown equality, for people; "" if there are none.

    Args:
        found: ``unknown`` and ``unknown_why``, of one file or of several.
    """
    if not found["unknown"]:
        return ""
    why = ", ".join(f"{count} {UNKNOWN_REASONS[name]}" for name, count in found["unknown_why"].items())
    return f"; {found['unknown']} cannot be told: {why}"


@dataclass(slots=True)
class Agreement:
    """Compares the maps of two solvers, frame by frame."""

    pixel_mm: tuple[float, float]
    frames: int = 0
    same_touched: int = 0
    """Both gates, or maps, say touched, or neither."""
    both: int = 0
    """Both show something."""
    correlations: list[float] = field(default_factory=list)
    """Of the maps, where both show something."""
    centres_mm: list[float] = field(default_factory=list)
    """Between the centres of what is above one half, where both have some."""

    def add(self, one: ComputedFrame, other: ComputedFrame) -> None:
        """Take one frame."""
        self.frames += 1
        self.same_touched += one.touched == other.touched
        if one.touched and other.touched and one.map.any() and other.map.any():
            self.both += 1
            correlation = float(np.corrcoef(one.map.ravel(), other.map.ravel())[0, 1])
            if np.isfinite(correlation):
                self.correlations.append(correlation)
            centres = centre_mm(one.map, self.pixel_mm), centre_mm(other.map, self.pixel_mm)
            if centres[0] is not None and centres[1] is not None:
                self.centres_mm.append(float(np.hypot(*(centres[0] - centres[1]))))

    def fields(self) -> dict[str, Any]:
        """Return plain values; None where there was nothing to compare."""
        return {
            "frames": self.frames,
            "touched_agreement": self.same_touched / self.frames if self.frames else None,
            "both_touched": self.both,
            "cc_median": _quantile(self.correlations, 0.5),
            "cc_p5": _quantile(self.correlations, 0.05),
            "centre_mm_median": _quantile(self.centres_mm, 0.5),
            "centre_mm_p95": _quantile(self.centres_mm, 0.95),
        }


def centre_mm(values: npt.NDArray[np.float32], pixel_mm: tuple[float, float]) -> npt.NDArray[np.float64] | None:
    """Return (x, y) of the centre of all that is above one half, weighted by the map; None if nothing is.

    Args:
        values: (rows, columns).
        pixel_mm: Width and height of a pixel.
    """
    weights = np.where(values > TOUCHED_LEVEL, values, 0.0).astype(np.float64)
    total = float(weights.sum())
    if not total:
        return None
    rows, columns = np.indices(values.shape)
    x_mm = float((weights * (columns + 0.5)).sum()) / total * pixel_mm[0]
    return np.array([x_mm, float((weights * (rows + 0.5)).sum()) / total * pixel_mm[1]])


def _quantile(values: list[float], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None


class FrameSolver(Protocol):
    """What makes a map of each frame."""

    def compute(self, step: Step) -> ComputedFrame | None:
        """Return the result of a frame; None if it is unknown."""


def comparison_solver(script: Script, recorded: Bundle, named: Path | None, solver: str | None) -> FrameSolver | None:
    """Return what to compare with what was running; None where that itself is asked for.

    Args:
        script: The recording.
        recorded: The bundle that was running.
        named: Another bundle's file; None for the same.
        solver: Its name; None for the bundle's own choice.

    Raises:
        SkinError: The bundle is of another skin, or cannot be used.
        ValueError: There is no such solver.
    """
    bundle = recorded if named is None else bundle_of(script, named)
    return None if solver is None and bundle.id == recorded.id else Rerun(script, bundle, solver)


Progress = Callable[[float, float], None]


Kept = list[tuple[Step, ComputedFrame]]
"""Frames whose maps are kept."""


@dataclass(frozen=True, slots=True, eq=False)
class Reinferred:
    """What came of it."""

    frames: int
    """Computed."""
    elapsed_s: float
    cpu_s: float
    recorded_s: float
    withheld: int
    equality: Equality | None
    """Against what was published; None with another bundle or solver."""
    agreement: Agreement | None
    """With what was running, of another bundle or solver."""
    kept: Kept
    others: Kept
    """The same frames by what was running, beside another solver's."""
    verified: dict[str, Any] | None = None
    """What the verifier's results come to; None of other solvers."""

    def fields(self) -> dict[str, Any]:
        """Return plain values for ``--json``."""
        rate = self.frames / self.elapsed_s if self.elapsed_s > 0 else 0.0
        found: dict[str, Any] = {
            "frames": self.frames,
            "withheld": self.withheld,
            "elapsed_s": round(self.elapsed_s, 3),
            "cpu_s": round(self.cpu_s, 3),
            "recorded_s": round(self.recorded_s, 3),
            "frames_per_s": round(rate, 1),
            "times_real_time": round(self.recorded_s / self.elapsed_s, 2) if self.elapsed_s > 0 else None,
        }
        if self.equality is not None:
            found |= self.equality.fields()
        if self.agreement is not None:
            found["against_recorded"] = self.agreement.fields()
        if self.verified is not None:
            found["verified"] = self.verified
        return found


def reinfer(
    script: Script,
    bundle: Bundle,
    solver: FrameSolver | None = None,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    every: int = 1,
    keep: int = 0,
    progress: Progress | None = None,
) -> Reinferred:
    """Compute a recording again.

    Args:
        script: The recording.
        bundle: The recorded one, for comparison.
        solver: Another solver, compared with the bundle's; None for the bundle itself, compared with the published
            maps.
        from_s: Begin so long after the first frame.
        to_s: End so long after it.
        every: One of this many frames goes to ``solver``, or is kept.
        keep: How many maps may be kept; 0 for none.
        progress: Called with the seconds done and all seconds.

    Raises:
        SkinError: The recording, its reference or its clouds cannot be used with the bundle.
    """
    rerun = Rerun(script, bundle)
    equality = Equality(rerun.field is not None) if solver is None and rerun.as_recorded else None
    agreement = None if solver is None else Agreement(bundle.skin.grid.pixel_mm)
    kept, others = Kept(), Kept()
    count = withheld = 0
    before: Step | None = None
    first_ns = last_ns = 0
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    for step in script.steps(from_s, to_s):
        first_ns, last_ns = first_ns or step.log_ns, step.log_ns
        found = rerun.compute(step, every=keep > 0 or solver is not None)
        before = _merged(before, step)
        other = None
        if solver is not None and count % every == 0:
            other, before = solver.compute(before), None
        count += 1
        withheld += bool(step.frame.withheld)
        if progress is not None and count % 200 == 0:
            progress((step.log_ns - script.first_ns) * 1e-9, script.seconds)
        if equality is not None:
            equality.add(step, found)
        if agreement is not None and found is not None and other is not None:
            agreement.add(found, other)
        shown = found if solver is None else other
        if keep and shown is not None and (count - 1) % every == 0:
            if len(kept) >= keep:
                raise RecordingError(f"more than {keep} maps to keep: choose a part with --from and --to, or --every")
            kept.append((step, shown))
            if solver is not None and found is not None:
                others.append((step, found))
    elapsed_s, cpu_s = time.perf_counter() - start_s, time.process_time() - start_cpu_s
    recorded_s, verified = (last_ns - first_ns) * 1e-9, getattr(solver, "verified", None)
    equality = equality if equality is not None and equality.published else None
    return Reinferred(count, elapsed_s, cpu_s, recorded_s, withheld, equality, agreement, kept, others, verified)


def _merged(before: Step | None, step: Step) -> Step:
    """Return a frame with all that changed at those before it, which were left out."""
    if before is None:
        return step
    return Step(
        step.frame,
        step.log_ns,
        step.conditions or before.conditions,
        step.cloud or before.cloud,
        step.reference or before.reference,
    )


def write(path: Path, found: Reinferred) -> None:
    """Write ``seq``, ``touched``, ``solver``, ``wall_ns``, ``map``, and ``recorded_map`` beside another solver.

    Of a solver that asks physics also ``p_value``, NaN where nothing touches, and ``flagged``.

    Raises:
        RecordingError: No maps were kept.
        OSError: The file cannot be written.
    """
    kept = found.kept
    if not kept:
        raise RecordingError("this part of the recording has no map")
    arrays = {
        "seq": np.array([step.frame.seq or 0 for step, _ in kept], dtype=np.int64),
        "touched": np.array([one.touched for _, one in kept], dtype=np.bool_),
        "solver": np.array([one.solver for _, one in kept]),
        "wall_ns": np.array([step.log_ns for step, _ in kept], dtype=np.int64),
        "map": np.array([one.map for _, one in kept], dtype=np.float32),
    }
    if found.others:
        arrays["recorded_map"] = np.array([one.map for _, one in found.others], dtype=np.float32)
    if found.verified is not None:
        verdicts = [None if one.judged is None else one.judged.verdict for _, one in kept]
        arrays["p_value"] = np.array([np.nan if one is None else one.p_value for one in verdicts])
        arrays["flagged"] = np.array([one is not None and one.flagged for one in verdicts], dtype=np.bool_)
    with replacing(path) as stream:
        save_arrays(stream, arrays, compressed=True)
