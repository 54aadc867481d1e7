"""``eitskin bench skip``: the CPU time that a skip of the frame loop saves.

::

    untouched  inference, while nothing touches; a bundle without a gate has no such row
    unchanged  inference, while only noise changes; also how like the kept map is to the one that was not computed

Costs are mean thread CPU times a frame of the runtime's own pipeline, with and without the skip, in turns in one run.
Making a frame's payload is not counted.
"""

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.monitor import health_of
from eitskin.model.bundle import Bundle, load_bundle
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference
from eitskin_proto.wire.frames import Frame, full_scale, quantise
from eitskin_proto.wire.messages import Hello
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import RECTANGLE, gather
from eitskin_tools.bench.harness import Row, machine, report, say
from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError

SEED: Final = 9105
"""Of bends; unlike any of eitskin_export and of the data sets."""

CONTRAST: Final = 20.0
"""S/m of the weakest touch."""

FRAMES_PER_TURN: Final = 10
"""Frames of one way before the other has its turn."""

BENDS: Final = 20
"""At which the untouched sheet is shown."""

STEADY_FRAMES: Final = 200
"""Of one touch, and then of two."""

NOISE: Final = "N2"
SNR_DB: Final = 50.0

HEADROOM: Final = 8.0
"""Full scale of the converters, relative to the largest voltage of the reference."""

SAMPLE_BYTES: Final = 4

REFERENCE_FRAMES: Final = 100


Array = npt.NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--frames", type=int, default=2000, metavar="N", help="frames of each way (default 2000)")
    parser.add_argument("--bundle", type=files.bundle, metavar="FILE", help="bundle to run (default: the shipped one)")
    parser.add_argument("--seed", type=int, default=0, help="of the noise (default 0)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.frames < 20:
        raise UsageError("--frames must be at least 20")
    rng = np.random.default_rng(arguments.seed)
    bundle = load_bundle(arguments.bundle)
    say("skip", "solving what the pipelines are shown")
    shown = Material.of(rng, arguments.frames)
    say("skip", "what each skip saves")
    rows = [unchanged(bundle, shown.frames, shown.one_V[:STEADY_FRAMES], shown.two_V)]
    if bundle.gate_arrays() is not None:
        rows.insert(0, untouched(bundle, shown.frames, shown.bent_V, shown.one_V, arguments.frames))
    summary = {f"{row['what']}_cpu_left": row["cpu_left"] for row in rows}
    return report(arguments, rows, summary, bundle=bundle.id, machine=machine())


class Frames:
    """Turns voltages into payloads, and makes pipelines that take them.

    Args:
        reference_V: (104,) V0.
        spread_V: (104,) V by which single frames of the reference vary.
    """

    def __init__(self, reference_V: Array, spread_V: Array) -> None:
        self._volts_per_count = HEADROOM * float(np.abs(reference_V).max()) / full_scale(SAMPLE_BYTES)
        self.reference = Reference(reference_V, spread_V, REFERENCE_FRAMES, "BENCH", 0, "paper", "")
        self.hello = Hello(
            firmware_version=(1, 0, 0), hardware_id=1, serial_number="BENCH", configuration_digest=0, generation=0,
            configuration_name="paper", rate_mHz=200_000, rows=len(reference_V), sample_bytes=SAMPLE_BYTES,
            volts_per_count=self._volts_per_count,
        )  # fmt: skip

    def payload(self, voltages: Array, sequence: int) -> bytes:
        """Return the payload of one frame; voltages beyond full scale are cut off and marked."""
        counts, saturation = quantise(voltages, self._volts_per_count, SAMPLE_BYTES)
        return Frame(sequence, (sequence * 5000) % 2**32, counts, saturation=saturation).pack()

    def pipeline(self, bundle: Bundle, *, skip_unchanged: bool = False) -> Pipeline:
        """Return a pipeline for the flat sheet's cloud, ready for frames."""
        pipeline = Pipeline(bundle, self.hello, skip_unchanged=skip_unchanged, health=health_of(bundle))
        pipeline.use_reference(self.reference)
        pipeline.start_with(GeometryGraph(bundle).geometry(None, None, 0))
        return pipeline


def without_gate(bundle: Bundle) -> Bundle:
    """Return a bundle that computes every frame."""
    return replace(bundle, files={name: data for name, data in bundle.files.items() if name != "gate.npz"})


def noisy(voltages: Array, times: int, reference_V: Array, rng: np.random.Generator) -> Array:
    """Return (n times, 104) V: each of (n, 104) or (104,) V repeated, with noise."""
    return add_noise(np.repeat(np.atleast_2d(voltages), times, axis=0), reference_V, NOISE, SNR_DB, rng)


@dataclass(frozen=True, slots=True)
class Material:
    """What pipelines are shown, with noise.

    Args:
        frames: Makes payloads and pipelines.
        bent_V: (n, 104) V of untouched sheets at bends of family A.
        one_V: (n, 104) V of one touch on the flat sheet.
        two_V: (m, 104) V of the same touch and a weak one of 10 mm.
    """

    frames: Frames
    bent_V: Array
    one_V: Array
    two_V: Array

    @classmethod
    def of(cls, rng: np.random.Generator, count: int) -> "Material":
        """Return it solved, with noise of its own for each of a number of frames: one that repeats is withheld."""
        sheet = inverted_sheet(Bend())
        reference_V = sheet.untouched_V
        taken = noisy(reference_V, REFERENCE_FRAMES, reference_V, rng)
        one = np.array([[RECTANGLE, 60.0, 50.0, 15.0, 15.0, 0.0, 50.0]])
        weak = np.array([[RECTANGLE, 100.0, 40.0, 10.0, 10.0, 0.0, CONTRAST]])
        one_V, two_V = set_voltages([sheet], gather([one, np.concatenate([one, weak])]))[0]
        bent_V = np.stack([inverted_sheet(bend).untouched_V for bend in draw("A", BENDS, SEED)])
        return cls(
            Frames(taken.mean(axis=0), taken.std(axis=0, ddof=1)),
            noisy(bent_V, -(-count // BENDS), reference_V, rng),
            noisy(one_V, max(count, STEADY_FRAMES), reference_V, rng),
            noisy(two_V, STEADY_FRAMES, reference_V, rng),
        )


class FrameRunner:
    """One pipeline and its own count of frames, so that ways in turns never see a number twice.

    Args:
        frames: Makes payloads.
        pipeline: Takes them.
        voltages: (n, 104) V; shown once.
    """

    def __init__(self, frames: Frames, pipeline: Pipeline, voltages: Array) -> None:
        self._make, self._voltages, self._sequence = frames.payload, voltages, 0
        self.pipeline = pipeline
        self._ready = b""
        self.prepare(0)

    def prepare(self, index: int) -> None:
        """Make the payload of the next frame, which is no part of what is measured."""
        self._sequence += 1
        self._ready = self._make(self._voltages[index], self._sequence)

    def __call__(self) -> bool:
        """Take the prepared frame through the pipeline, and do what waits for leisure when it is due."""
        pipeline = self.pipeline
        fit = pipeline.accept(self._ready, time.perf_counter_ns()) and pipeline.compute(True)
        pipeline.keep_for_health()
        if pipeline.has_leisure_work:
            pipeline.check_health()
        return fit


def interleaved(ways: Mapping[str, FrameRunner], frames: int) -> dict[str, float]:
    """Return every way's mean CPU time a frame, us.

    Args:
        ways: By name.
        frames: Of each.
    """
    cpu_ns = dict.fromkeys(ways, 0)
    for way in ways.values():
        way()  # the frame that it was made with; the first is slower
    for start in range(0, frames, FRAMES_PER_TURN):
        for name, way in ways.items():
            for index in range(start, min(start + FRAMES_PER_TURN, frames)):
                way.prepare(index)
                begin_ns = time.thread_time_ns()
                way()
                cpu_ns[name] += time.thread_time_ns() - begin_ns
    return {name: round(spent_ns / frames / 1e3, 2) for name, spent_ns in cpu_ns.items()}


def saving(what: str, times_us: dict[str, float]) -> Row:
    """Return a row of the times of "with" and "without", and what lies between: CPU a frame, and the share left."""
    one, other = times_us["with"], times_us["without"]
    named = {f"{way}_us": time_us for way, time_us in times_us.items()}
    return {"what": what, **named, "cpu_saved_us": round(other - one, 2), "cpu_left": round(one / other, 4)}


def untouched(bundle: Bundle, frames: Frames, bent_V: Array, touched_V: Array, count: int) -> Row:
    """Return the row of "nothing touched", beside what a touched frame costs."""
    ways = {
        "with": FrameRunner(frames, frames.pipeline(bundle), bent_V),
        "without": FrameRunner(frames, frames.pipeline(without_gate(bundle)), bent_V),
        "touched": FrameRunner(frames, frames.pipeline(bundle), touched_V),
    }
    row = saving("untouched", interleaved(ways, count))
    return {**row, "untouched_to_touched": round(row["with_us"] / row["touched_us"], 4)}


def unchanged(bundle: Bundle, frames: Frames, resting_V: Array, changed_V: Array) -> Row:
    """Return the row of "map unchanged": a touch at rest, then a second one beside it.

    Args:
        bundle: What is deployed.
        frames: Makes payloads.
        resting_V: (n, 104) noisy frames of one touch.
        changed_V: (m, 104) noisy frames of two.
    """
    stream, first = np.concatenate([resting_V, changed_V]), len(resting_V)

    def ways() -> dict[str, FrameRunner]:
        kept = FrameRunner(frames, frames.pipeline(bundle, skip_unchanged=True), stream)
        return {"with": kept, "without": FrameRunner(frames, frames.pipeline(bundle), stream)}

    row = saving("unchanged", interleaved(ways(), len(stream)))
    kept, computed = ways().values()
    likeness, fresh = [], []
    for index in range(len(stream)):
        for way in (kept, computed):
            way.prepare(index)
            way()
        fresh.append(kept.pipeline.record.inferred)
        likeness.append(float(np.corrcoef(kept.pipeline.buffers.map[0], computed.pipeline.buffers.map[0])[0, 1]))
    late = np.flatnonzero(fresh[first:])
    return {
        **row,
        "share_skipped_at_rest": round(1.0 - float(np.mean(fresh[1:first])), 4),
        "cc_with_computed_map": float(np.mean(likeness)),
        "cc_with_computed_map_least": float(np.min(likeness)),
        "frames_until_change_is_seen": int(late[0]) if len(late) else None,
    }
