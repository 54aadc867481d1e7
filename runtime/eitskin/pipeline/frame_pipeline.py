"""One frame through decode, normalise, gate and inference, each stage stamped, nothing allocated.

The pipeline owns the memory that a frame passes through and the decisions about it; it knows no socket and no port. It
puts its results into a record (:mod:`eitskin.frame_record`), together with the steps that it skipped:
``inference:untouched``, ``inference:no_subscriber``, ``inference:unchanged``, ``map:untouched``, ``acquisition:idle``,
``geometry:cloud_unchanged``. Frames unfit to publish are withheld (:mod:`eitskin.pipeline.intake`).

:class:`GateAudit` detects a touch that the gate misses. It infers one in ``AUDIT_FRAMES`` of the frames that the gate
calls untouched. If the network's map shows a strong touch, it overrules the gate: the frame is published with its map
and the event ``gate_overruled``, and every frame is inferred until a map shows no strong touch. If rows are missing,
which impairs a gate more than a network trained without them, it infers one frame in ``WITHOUT_ROWS``. The bundle says
how many pixels make a strong touch (``audit_pixels`` in gate.npz): more than the network ever shows of an untouched
sheet. Without that number no frame is inferred.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BadReference, BundleError
from eitskin.frame_record import DECODE, GATE, INFER, NORMALISE, READ, FrameRecord
from eitskin.health.imputation import MISSING
from eitskin.health.monitor import Health
from eitskin.model.buffers import Buffers, Engine
from eitskin.model.bundle import Bundle
from eitskin.model.denormals import flushed
from eitskin.model.gate import Gate
from eitskin.model.geometry import Geometry
from eitskin.model.taught import TaughtField, field_of
from eitskin.pipeline.idle import IdleGate
from eitskin.pipeline.intake import Intake
from eitskin.pipeline.map_source import MapSource
from eitskin.pipeline.recorded import FrameDecisions
from eitskin.pipeline.touch_doubts import TouchDoubts
from eitskin.reference.captured import Reference
from eitskin.reference.front_end import stuck
from eitskin.reference.normaliser import Normaliser, normaliser_of
from eitskin.reference.predicted import log_ratio
from eitskin.reference.repeats import Repeats
from eitskin.reference.row_noise import relative_spread, with_rounding
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.row_table import ADJACENT_104, RowTable
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import Skin as SkinDescription
from eitskin_proto.wire.frames import full_scale
from eitskin_proto.wire.messages import Hello
from eitskin_proto.wire.volts import DriverHello, step_of

AUDIT_FRAMES: Final = 50
"""One of this many untouched frames is inferred: four a second at 200 frames/s, for 2 % of an inference a frame."""

WITHOUT_ROWS: Final = 4
"""The same while rows are missing: then the gates of random devices miss more of the light touches, beside the gap."""

REVERSED_SIGMAS: Final = 6.0
REVERSED_SHARE: Final = 0.05
"""A row is reversed that reads below 0 by as many of its standard deviations, and by this share of its reference."""

_OF_OTHERS: Final = ~np.array([rows_of(two) for two in combinations(range(N_ELECTRODES), 2)])
"""(120, 104) rows at neither of two electrodes."""

LOOK_FRAMES: Final = 48
"""One of this many frames is held against what rows of a sheet have in common, and each in which a touch begins; the
step from the frame before always is."""

STRONG_VALUE: Final = 0.5
"""A pixel above it is touched."""


def audit_pixels(arrays: Mapping[str, npt.NDArray[np.generic]] | None, n_pixels: int) -> int | None:
    """Return how many pixels make a strong touch, by a bundle's gate.npz, or None if it does not say.

    Args:
        arrays: Of gate.npz.
        n_pixels: Of a map.

    Raises:
        BundleError: It says nonsense.
    """
    if arrays is None or "audit_pixels" not in arrays:
        return None
    found = np.asarray(arrays["audit_pixels"])
    if found.size != 1 or found.dtype.kind not in "iu" or not 1 <= int(found.reshape(-1)[0]) <= n_pixels:
        raise BundleError(
            f"gate.npz: audit_pixels is {found.tolist()}, expected one whole number from 1 to {n_pixels}; make the "
            "bundle again with 'eitskin export'"
        )
    return int(found.reshape(-1)[0])


class GateAudit:
    """Counts untouched frames and judges the maps of the inferred ones; allocates nothing a frame.

    Args:
        pixels: Number of pixels above ``STRONG_VALUE`` that shows a strong touch; None for no audit.
        n_pixels: Of a map.
    """

    __slots__ = ("_above", "_pixels", "_since_look", "_suspicious", "overruled")

    def __init__(self, pixels: int | None, n_pixels: int) -> None:
        self._pixels = pixels
        self._above = np.zeros(n_pixels, dtype=np.bool_)
        self._since_look = 0
        self._suspicious = False
        self.overruled = 0
        """Frames in which a map overruled the gate so far."""

    def is_due(self, *, lacks_rows: bool) -> bool:
        """Return whether an untouched frame is to be inferred; called once for each of them."""
        if self._pixels is None:
            return False
        self._since_look += 1
        each = WITHOUT_ROWS if lacks_rows else AUDIT_FRAMES
        if self._suspicious or self._since_look >= each:
            self._since_look = 0
            return True
        return False

    def overrules(self, touch_map: npt.NDArray[np.float32]) -> bool:
        """Return whether the map of an audited frame shows a strong touch.

        Args:
            touch_map: (pixels,) of a network; a projection's is scaled to 1 whatever it shows, and says nothing.
        """
        np.greater(touch_map, STRONG_VALUE, out=self._above)
        self._suspicious = self._pixels is not None and int(np.count_nonzero(self._above)) >= self._pixels
        self.overruled += self._suspicious
        return self._suspicious


class FrontEndWatch:
    """Looks for faults of the front end in the current frame.

    Args:
        hello: Of the device.
        table: Rows in use.
        intake: Has the frame's counts.
        idle_gate: Has the rows of a scan of a few drives.
    """

    __slots__ = (
        "_below", "_idle_gate", "_intake", "_limit", "_lowest", "_own_rows", "_reference", "_step", "idle_repeats",
        "repeats",
    )  # fmt: skip

    def __init__(self, hello: Hello, table: RowTable, intake: Intake, idle_gate: IdleGate | None) -> None:
        self._step: float | None = None
        """Volts of the converter's step, where a count is a volt."""
        if isinstance(hello, DriverHello):
            self._step, self._limit = hello.step_V, hello.full_scale_V / hello.step_V
        else:
            self._limit = full_scale(hello.sample_bytes)
        self._own_rows = table.id == ADJACENT_104.id
        self._intake, self._idle_gate = intake, idle_gate
        self._reference: npt.NDArray[np.float64] | None = None
        self.repeats = Repeats(table.rows)
        """Of whole frames."""
        self.idle_repeats = Repeats(0 if idle_gate is None else len(idle_gate.rows))
        self._lowest = np.full(table.rows, -np.inf, dtype=np.float32)
        self._below = np.zeros(table.rows, dtype=np.bool_)

    def use_reference(self, reference: Reference, step_V: float) -> None:
        """Judge by another reference from the next frame on.

        Args:
            reference: The reference.
            step_V: Of one count.
        """
        self._reference = reference.voltages_V / step_V
        self._reference[reference.weak] = 0.0
        unit_V = step_V if self._step is None else 1.0  # drivers send volts
        size, spread, limit = reference.voltages_V / unit_V, reference.spread_V / step_V, self._limit * step_V / unit_V
        self.repeats.use_reference(size, spread, limit)
        if self._idle_gate is not None:
            rows = self._idle_gate.rows
            self.idle_repeats.use_reference(size[rows], spread[rows], limit)
        sigma = relative_spread(reference.voltages_V, reference.spread_V)
        self._lowest[:] = -1.0 - np.maximum(REVERSED_SIGMAS * sigma, REVERSED_SHARE)

    def reversed(self, change: npt.NDArray[np.float32], missing: npt.NDArray[np.bool_] | None) -> bool:
        """Return whether rows of dV have the other sign than their reference, which no current through a sheet does.

        Args:
            change: (rows,) dV.
            missing: (rows,) rows that are filled in whatever they read; None for none.
        """
        np.less(change, self._lowest, out=self._below)
        if missing is not None:
            np.greater(self._below, missing, out=self._below)
        # Electrodes along a border order the rows' signs; of rows of an unknown protocol most must have turned
        return int(np.count_nonzero(self._below)) > (0 if self._own_rows else len(change) // 2)

    def forget(self) -> None:
        """Hold the next frames against none before them."""
        self.repeats.forget()
        self.idle_repeats.forget()

    def is_of_wires(self) -> bool:
        """Return whether all reversed rows are those of some two electrodes, whose wires may be exchanged."""
        return self._own_rows and not (self._below & _OF_OTHERS).any(axis=1).all()

    def check(self, normaliser: Normaliser) -> str:
        """Return the fault in the rows of a whole frame that no sheet can have, or "".

        Args:
            normaliser: Has the frame.
        """
        cut_off, counts = self._intake.saturation, normaliser.counts
        if cut_off:
            cut_off = normaliser.cut_off(cut_off, len(self._intake.counts))
        if self._step is not None:
            counts = np.rint(counts / self._step)
        return stuck(counts, self._reference, cut_off, self._limit, own_rows=self._own_rows)

    def check_idle(self) -> str:
        """Return the same of a frame of a few drives."""
        assert self._idle_gate is not None
        reference = None if self._reference is None else self._reference[self._idle_gate.rows]
        return stuck(self._intake.counts, reference, self._intake.saturation, self._limit)


def prediction_against(
    predicted: npt.ArrayLike, predicted_flat: npt.ArrayLike | None, reference: Reference | None, *, fills: bool
) -> npt.NDArray[np.float32]:
    """Return the (104,) log(V_pred / V0) of a prediction.

    Args:
        predicted: (104,) V of a surface untouched.
        predicted_flat: (104,) V of the flat sheet by the same model; None takes the reference.
        reference: The reference of the frames; None while there is none.
        fills: Whether weak rows are filled in and can be compared with a whole prediction; else they are ignored.

    Raises:
        BadReference: There is no reference to compare it with.
        ValueError: The voltages are malformed, or cannot be of one sheet.
    """
    against = predicted_flat
    if against is None:
        if reference is None:
            raise BadReference("a prediction needs predicted_flat, or a captured reference to compare with")
        against = reference.flat().voltages_V
    ratio = log_ratio(predicted, against)
    if reference is not None and (predicted_flat is None or not fills):
        ratio[reference.weak] = 0.0
    return ratio


class GeometryInUse:
    """Gives a pipeline's buffers geometries whose predictions are relative to the reference in use.

    Args:
        buffers: Of the pipeline.
        field: What the sheet was taught, which takes predictions too; None without.
        fills: As in :func:`prediction_against`.
    """

    def __init__(self, buffers: Buffers, field: TaughtField | None, *, fills: bool) -> None:
        self._buffers, self._field, self._fills = buffers, field, fills
        self._reference: Reference | None = None

    def use_reference(self, reference: Reference) -> None:
        """Use another reference for the present geometry and later ones."""
        self._reference = reference
        if self._buffers.geometry is not None:
            self.use_geometry(self._buffers.geometry)

    def use_geometry(self, geometry: Geometry) -> None:
        """Use another geometry."""
        self._buffers.use_geometry(self._held(geometry))
        if self._field is not None:
            self._field.use_prediction(self._buffers.log_predicted[0])

    def _held(self, geometry: Geometry) -> Geometry:
        """Return the same object where that changes nothing, or where no sheet is like that: then it stays as it is."""
        given, reference = geometry.given, self._reference
        if reference is None or given is None or given.predicted is None:
            return geometry
        try:
            found = prediction_against(given.predicted, given.predicted_flat, reference, fills=self._fills)
        except ValueError:
            return geometry
        ratio = flushed(found[None])
        return geometry if np.array_equal(ratio, geometry.log_predicted) else replace(geometry, log_predicted=ratio)


CLOUD_UNCHANGED: Final = ("geometry:cloud_unchanged",)
UNTOUCHED: Final = ("inference:untouched", *CLOUD_UNCHANGED)
MAP_UNTOUCHED: Final = ("map:untouched", *CLOUD_UNCHANGED)
NO_SUBSCRIBER: Final = ("inference:no_subscriber", *CLOUD_UNCHANGED)
IDLE: Final = ("acquisition:idle", "inference:idle", *CLOUD_UNCHANGED)
UNCHANGED: Final = ("inference:unchanged", *CLOUD_UNCHANGED)


class Pipeline:
    """Everything between a payload and a map.

    Args:
        bundle: The solvers.
        hello: Of the device.
        budget_ns: From read to publish; None for no budget.
        solver: The most accurate solver to use; None for the bundle's own choice
            (:func:`eitskin.model.engine.default_solver`) or, with a budget, its most accurate one.
        skip_unchanged: Whether a touched frame keeps the map of an earlier one if they differ only by noise.
        health: Monitors electrodes and drift; None if the bundle cannot.
        idle_gate: Judges frames of a few drives; without one they are withheld.
        skin: The one in use, if it is known better than when the bundle was made; None for the bundle's.

    Raises:
        BundleError: A solver of the bundle cannot be used.
        BudgetError: Not even the fastest solver meets the budget.
        ValueError: The bundle has no such solver.
    """

    def __init__(
        self,
        bundle: Bundle,
        hello: Hello,
        budget_ns: int | None = None,
        *,
        solver: str | None = None,
        skip_unchanged: bool = False,
        health: Health | None = None,
        idle_gate: IdleGate | None = None,
        skin: SkinDescription | None = None,
    ) -> None:
        self.skin = bundle.skin if skin is None else skin
        """The one in use."""
        grid = bundle.skin.grid
        arrays = bundle.gate_arrays()
        self.field, self._shape = field_of(bundle), ""
        """What the sheet was taught, which is its gate too; None for a bundle that was not."""
        self.gate = self.field or (None if arrays is None else Gate(arrays))
        self.audit = GateAudit(audit_pixels(arrays, grid.n_pixels), grid.n_pixels)
        self.health = health
        self.idle_gate = idle_gate
        self.decisions = FrameDecisions()
        """Filled in before each frame where frames are computed again as a recording says."""
        self.buffers = Buffers(bundle, None if self.gate is None else self.gate.change)
        self._prediction = GeometryInUse(self.buffers, self.field, fills=health is not None)
        self._change = self.buffers.change[0]
        self.record = FrameRecord(memoryview(self.buffers.map[0]).cast("B"))
        """The frame in hand; the next one overwrites it."""
        self.intake = Intake(hello, self.record, None if idle_gate is None else idle_gate.drives)
        self.table = bundle.table
        """Rows of its frames."""
        self.front_end = FrontEndWatch(hello, self.table, self.intake, idle_gate)
        self.counter, self.clock = self.intake.counter, self.intake.clock
        self.normaliser = normaliser_of(hello, self.table)
        self.step_V = step_of(hello)
        """Of the device's converter."""
        self.maps = MapSource(
            bundle,
            self.buffers,
            self.record,
            budget_ns,
            solver=solver,
            skip_unchanged=skip_unchanged,
            field=self.field,
        )
        self.budget = self.maps.budget
        self.doubts = TouchDoubts(bundle, self.maps, self.buffers, self.record)
        self.bundle = bundle
        self._is_wire = not isinstance(hello, DriverHello)
        self._flat: Reference | None = None
        self._next_geometry: Geometry | None = None
        self._was_touched = self._suspicious = self._compared = False
        self._since_look = 0

    @property
    def engines(self) -> list[Engine]:
        """The engines, from the most accurate to the fastest."""
        return self.maps.engines

    def greet(self, hello: Hello) -> None:
        """Adopt the HELLO of a repeated handshake."""
        self.intake.greet(hello)
        self._reset_gates()
        self.normaliser.use_scale(hello.volts_per_count)
        self.step_V = step_of(hello)

    def use_reference(self, reference: Reference, *, fresh: bool = False) -> None:
        """Normalise against a reference, or the flat one that its scan makes of it; a fresh one is of the sheet now.

        Its rows are those in use (:meth:`eitskin.reference.captured.Reference.in_table`).
        """
        step_V, flat = self.step_V, reference.flat()
        self.normaliser.use_reference(flat.voltages_V, flat.weak)
        if self.field is not None:
            known_V = flat.voltages_V.copy()
            known_V[flat.weak] = 0.0
            spread_V = with_rounding(flat.spread_V, step_V)
            self.field.use_reference(known_V, spread_V, flat.shared_V, flat.frames, flat.steady_frames)
        self._reset_gates()
        self.front_end.use_reference(reference, step_V)
        if self.health is not None:
            spread_V = with_rounding(flat.spread_V, step_V)
            gate = self.gate if isinstance(self.gate, Gate) else None
            self.health.use_reference(
                flat.voltages_V, spread_V, gate, frames=flat.frames, fresh=fresh, shared_V=flat.shared_V
            )
        self.maps.drop_map()
        self._flat = flat
        self.leave_out_missing()
        self._prediction.use_reference(reference)

    def leave_out_missing(self) -> None:
        """Let projections and the mean of frames do without the rows that are missing now."""
        if self.health is not None:
            self.maps.change_projection(self.health.projection)
        if self.field is None and (flat := self._flat) is not None:
            known_V = flat.voltages_V if self._missing is None else np.where(self._missing, 0.0, flat.voltages_V)
            self.maps.stillness.use_reference(
                known_V, flat.spread_V, flat.frames, self.step_V, flat.shared_V, flat.steady_frames
            )

    def _reset_gates(self) -> None:
        """Let the gates judge the next frame by itself: the reference, or the device, is another one."""
        for gate in (self.gate, self.idle_gate):
            if gate is not None:
                gate.reset()

    def start_with(self, geometry: Geometry) -> None:
        """Use a geometry at once, without an event; only between two frames of the same thread."""
        self._prediction.use_geometry(geometry)
        self.record.cloud = geometry.revision
        self.maps.drop_map()

    def use_geometry(self, geometry: Geometry) -> None:
        """Use a geometry from the next frame on; may be called from another thread."""
        self._next_geometry = geometry

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Go on without these electrodes from the next frame on; may be called from another thread.

        Raises:
            BundleError: The bundle does not know how to go on without an electrode.
            ValueError: One does not exist, or there are too many.
        """
        if self.health is None:
            raise BundleError(f"{self.bundle.path}: excluding electrodes is {MISSING}")
        self.health.exclude(electrodes)

    def accept(self, payload: bytes, read_ns: int) -> bool:
        """Decode a frame and return whether it may go on; the first half of a frame's way.

        Args:
            payload: Of a FRAME, or VOLTS of a driver.
            read_ns: When its last byte was in hand.
        """
        intake, record = self.intake, self.record
        if not intake.accept(payload, read_ns):
            return False
        if record.resets != self.counter.resets:  # frames are counted from 0 again
            record.resets = self.counter.resets
            self.maps.start_mean()
            self.front_end.forget()
        if record.idle and self.idle_gate is not None:
            self.idle_gate.load(intake.counts)
        else:
            self.normaliser.load(intake.counts)
        self._compared = bool(self._suspicious or intake.repeated or (self.health and self.health.hanging_count))
        if self._compared and self._hangs():
            if self.field is None:
                self._reset_gates()  # they may have learned from frames that were old in part
            return intake.give_up("frozen")
        record.stamps[DECODE] = time.perf_counter_ns()
        return True

    def forget_frames(self) -> None:
        """Hold the next frames against none before them: a recording begins again."""
        self.intake.forget()
        self.front_end.forget()

    def _compare(self) -> tuple[npt.NDArray[np.number], Repeats]:
        """Hold the frame against the one before; return its counts and what they were held against."""
        idle, watch = self.record.idle, self.front_end
        counts, repeats = (self.intake.counts, watch.idle_repeats) if idle else (self.normaliser.counts, watch.repeats)
        self._suspicious = repeats.add(counts)
        return counts, repeats

    def _hangs(self) -> bool:
        """Return whether the frame is old, or rows of it hang that are too many to fill in."""
        health, intake = None if self.record.idle else self.health, self.intake
        counts, repeats = self._compare()
        old = repeats.is_old(counts, intake.repeated, intake.remembered)
        if health is None:
            return old or bool(repeats.hanging.any())
        if health.hang(repeats.hanging):
            self.leave_out_missing()
        return old or bool((repeats.hanging & ~health.electrodes.missing).any())

    def load_recorded(self, payload: bytes, sequence: int) -> bool:
        """Take a frame that was accepted when it was measured, and return whether it is a whole scan.

        Args:
            payload: Of a FRAME, or VOLTS of a driver.
            sequence: Its number, unwrapped.

        Raises:
            ProtocolError: It is not a scan of this device.
        """
        if not self.intake.load(payload):
            return False
        self.record.sequence, self.record.events = sequence, ()
        self.normaliser.load(self.intake.counts)
        return True

    def compute(self, wanted: bool) -> bool:
        """Normalise, judge and infer the accepted frame, and return whether it is fit to publish.

        Args:
            wanted: Whether frames have a subscriber; otherwise only the gate runs.
        """
        record = self.record
        stamps = record.stamps
        fresh_cloud = self._use_new_geometry()
        record.inferred = False
        if record.idle:
            return self._compute_idle()
        if not self.normaliser.change_into(self._change):
            return self.intake.give_up("no_signal" if self.normaliser.silent else "implausible")
        if self.normaliser.far and self.front_end.check(self.normaliser):
            return self.intake.give_up("stuck")
        health, decided, gate = self.health, self.decisions, self.gate
        if health is not None:
            health.prepare(self._change)
            record.events += health.take_events()
        judged = decided.touched is None
        if judged and self.normaliser.far and self.front_end.reversed(self._change, self._missing):
            of_wires = self.front_end.is_of_wires()
            return self._give_up_fault("reversed") if of_wires else self.intake.give_up("reversed")
        stamps[NORMALISE] = time.perf_counter_ns()
        record.touched = True  # without a gate every frame is computed
        if self.field is not None and decided.keeps_map is not None:
            self.field.stillness.alone = decided.fused == 1 and not decided.keeps_map
        if gate is not None:
            record.touched, record.gate_logit = gate.touched(), gate.logit
        if self.field is not None and self.field.shape != self._shape:
            self._shape = self.field.shape
            record.events += (f"shape:{self._shape}",)
        if decided.touched is not None:
            record.touched = decided.touched
        if health is not None:
            health.complete(self._change, self.buffers.log_predicted[0])
            if judged and not self._is_a_sheet(health):
                return False
        self._since_look += 1
        stamps[GATE] = time.perf_counter_ns()
        if not record.touched and wanted and self._infers_untouched() and self._infer_untouched():
            record.touched = True
            record.skipped = () if fresh_cloud else CLOUD_UNCHANGED
        elif not record.touched or not wanted:
            self.maps.show_nothing()
            record.skipped = NO_SUBSCRIBER if record.touched else MAP_UNTOUCHED if record.inferred else UNTOUCHED
        elif self.maps.reuse_map(decided):
            record.skipped = UNCHANGED
        elif not self.maps.infer(decided.solver):
            return self.intake.give_up("implausible")
        else:
            record.skipped = () if fresh_cloud else CLOUD_UNCHANGED
        self._describe()
        stamps[INFER] = time.perf_counter_ns()
        return True

    @property
    def _missing(self) -> npt.NDArray[np.bool_] | None:
        """Return (104,) the rows that are filled in; None if nothing fills rows in."""
        return None if self.health is None else self.health.electrodes.missing

    def _is_a_sheet(self, health: Health) -> bool:
        """Hold the frame against what rows of a sheet have in common; withhold it if it fails."""
        look = self.record.touched != self._was_touched or self._since_look >= LOOK_FRAMES
        electrodes, change = health.electrodes, self._change
        mixed_up = electrodes.weigher.is_mixed_up(change, look=look)
        unlike = mixed_up or (look and electrodes.weigher.is_unlike(change))
        doubtful = self.record.touched and electrodes.unclear
        if self.record.touched and electrodes.findings and not unlike:
            doubtful, unlike = health.doubts(change)
        if look or unlike:
            self._was_touched, self._since_look = self.record.touched and not unlike, LOOK_FRAMES * unlike
        if (unlike or doubtful) and self.field is None:
            self._reset_gates()  # they may have learned from the frame
        if mixed_up:  # no failure of an electrode does that
            return self.intake.give_up("unlike")
        return not unlike or self._give_up_fault("unlike")

    def _give_up_fault(self, reason: str) -> bool:
        """Withhold the frame in hand, and let health look for the electrode that explains it."""
        if self.health is not None and self.health.put_aside(self._own_counts, touched=True):
            self.check_health()
        return self.intake.give_up(reason)

    @property
    def _own_counts(self) -> npt.NDArray[np.int32] | None:
        """Return the counts of the wire; None of a driver."""
        return self.intake.counts if self._is_wire else None

    def _compute_idle(self) -> bool:
        """Judge a frame of a few drives; there is no map in it."""
        gate, record = self.idle_gate, self.record
        assert gate is not None
        touched = gate.touched(self.normaliser)
        if touched is None:
            return self.intake.give_up("implausible")
        if gate.far and self.front_end.check_idle():
            return self.intake.give_up("stuck")
        record.touched, record.gate_logit = touched, gate.gate.logit
        record.stamps[NORMALISE] = record.stamps[GATE] = time.perf_counter_ns()
        self.maps.show_nothing()
        record.skipped = IDLE
        self._describe()
        record.stamps[INFER] = time.perf_counter_ns()
        return True

    def _describe(self) -> None:
        """Record the state in which the frame was computed."""
        record, health = self.record, self.health
        self.intake.name_events()
        record.weak_rows = self.normaliser.weak_count
        if health is not None:
            record.weak_rows += health.hanging_count
            record.drift, record.electrodes = health.drift.distance, health.electrodes.texts

    def _use_new_geometry(self) -> bool:
        """Adopt changes from other threads since the last frame, and return whether there was a cloud."""
        geometry = self._next_geometry
        if geometry is None:
            return False
        self._next_geometry = None
        self.start_with(geometry)
        self.record.cloud_sequence = self.record.sequence
        self.record.events += ("cloud", *(f"cloud:unlike_training:{mode}" for mode in geometry.unlike))
        if geometry.why == "fitted":
            self.record.events += ("cloud:fitted",)
        return True

    def _infers_untouched(self) -> bool:
        """Return whether the map of this untouched frame is to be computed all the same; asked once for each."""
        lacks_rows = self.health is not None and self.health.lacks_rows
        found, decided = self.audit.is_due(lacks_rows=lacks_rows), self.decisions.inferred_untouched
        return found if decided is None else decided

    def _infer_untouched(self) -> bool:
        """Infer a frame that the gate calls untouched, and return whether its map shows a strong touch all the same."""
        if not self.maps.can_overrule:
            return False
        record = self.record
        before = record.solver, record.map_sequence
        if self.maps.infer_alone() and self.audit.overrules(self.maps.map):
            record.events += ("gate_overruled",)
            return True
        record.solver, record.map_sequence = before
        self.maps.drop_map()  # this frame goes out without a touch: none behind it may have its map under its number
        return False

    def keep_for_health(self) -> None:
        """Keep the data of the frame just published, for judging electrodes and drift, and look at its touches."""
        health, record = self.health, self.record
        if not self._compared:  # of honest frames only here, where no subscriber waits for it
            self._compare()
        if health is not None and not record.idle and health.put_aside(self._own_counts, touched=record.touched):
            self.check_health()
        if self.doubts.due and self.decisions.touched is None and (event := self.doubts.look()):
            self.intake.add_event(event)

    def check_health(self) -> None:
        """Examine electrodes and drift in the last few frames; changes act on the next one."""
        if self.health is not None and self.health.examine(self.buffers.log_predicted[0]):
            self.leave_out_missing()

    @property
    def has_leisure_work(self) -> bool:
        """Whether there is something to do while the line rests."""
        return self.health is not None and self.health.due

    def judge(self, now_ns: int) -> None:
        """Hold the frame against the budget; an overrun is an event of this very frame."""
        record, budget = self.record, self.budget
        if budget.budget_ns is not None and budget.judge(now_ns - record.stamps[READ], inferred=record.inferred):
            record.events += ("overrun",)
        record.overrun = budget.overruns
