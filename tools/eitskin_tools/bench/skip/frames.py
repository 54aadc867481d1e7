"""Frames for a pipeline without a device: payloads of voltages, a reference and what a device would say of itself."""

import time
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.monitor import health_of
from eitskin.model.bundle import Bundle
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference
from eitskin_proto.wire.frames import Frame
from eitskin_proto.wire.messages import Hello
from eitskin_tools.bench.skip.scenes import CONTRAST, bends_of, still

NOISE: Final = "N2"
SNR_DB: Final = 50.0

FULL_SCALE: Final = 2**23 - 1
"""Counts of a 24-bit converter; the largest voltage takes an eighth of it, which a sheet never exceeds."""

REFERENCE_FRAMES: Final = 100

Array = npt.NDArray[np.float64]


class Frames:
    """Turns voltages into payloads, and makes pipelines that take them.

    Args:
        reference_V: (104,) V0.
        rng: Source of the reference's noise.
    """

    def __init__(self, reference_V: Array, rng: np.random.Generator) -> None:
        self._volts_per_count = 8.0 * float(np.abs(reference_V).max()) / FULL_SCALE
        taken = noisy(reference_V, REFERENCE_FRAMES, reference_V, rng)
        self.reference = Reference(
            taken.mean(axis=0), taken.std(axis=0, ddof=1), REFERENCE_FRAMES, "BENCH", 0, "paper", ""
        )
        self.hello = Hello(
            firmware_version=(1, 0, 0), hardware_id=1, serial_number="BENCH", configuration_digest=0, generation=0,
            configuration_name="paper", rate_mHz=200_000, rows=len(reference_V), sample_bytes=4,
            volts_per_count=self._volts_per_count,
        )  # fmt: skip

    def payload(self, voltages: Array, sequence: int) -> bytes:
        """Return the payload of one frame."""
        counts = np.rint(voltages / self._volts_per_count).astype(np.int32)
        return Frame(sequence=sequence, device_us=(sequence * 5000) % 2**32, counts=counts).pack()

    def pipeline(self, bundle: Bundle, *, skip_unchanged: bool = False) -> Pipeline:
        """Return a pipeline for the flat sheet's cloud, ready for frames."""
        pipeline = Pipeline(bundle, self.hello, skip_unchanged=skip_unchanged, health=health_of(bundle))
        pipeline.use_reference(self.reference)
        pipeline.start_with(GeometryGraph(bundle).geometry(None, None, 0))
        return pipeline


def noisy(voltages: Array, times: int, reference_V: Array, rng: np.random.Generator) -> Array:
    """Return (n times, 104) V: each of (n, 104) or (104,) V so many times, with noise."""
    from eitskin_sim.measurement.noise import add_noise

    return add_noise(np.repeat(np.atleast_2d(voltages), times, axis=0), reference_V, NOISE, SNR_DB, rng)


@dataclass(frozen=True, slots=True)
class Material:
    """What pipelines are shown, with noise.

    Args:
        frames: Makes payloads and pipelines.
        reference_V: (104,) V0.
        bent_V: (n, 104) V of untouched sheets at bends of family A.
        one_V: (n, 104) V of one touch on the flat sheet.
        two_V: (n, 104) V of the same touch and a weak one of 10 mm.
        weak_V: (n, 104) V of the weak one alone.
    """

    frames: Frames
    reference_V: Array
    bent_V: Array
    one_V: Array
    two_V: Array
    weak_V: Array

    @classmethod
    def of(cls, rng: np.random.Generator, bends: int = 20, each: int = 200) -> "Material":
        """Return it solved."""
        from eitskin_sim.freeform.sheet import inverted_sheet
        from eitskin_sim.freeform.voltages import set_voltages
        from eitskin_sim.scene.touch_table import gather
        from eitskin_training.gate.touches import squares

        sheet = inverted_sheet(bends_of("flat", 1)[0])
        reference_V = sheet.untouched_V
        one = squares([(60.0, 50.0)], 15.0, 50.0)[0]
        weak = squares([(100.0, 40.0)], 10.0, CONTRAST)[0]
        one_V, two_V, weak_V = set_voltages([sheet], gather([one, np.concatenate([one, weak]), weak]))[0]
        bent_V = reference_V * np.exp(still("A", bends))
        return cls(
            Frames(reference_V, rng),
            reference_V,
            noisy(bent_V, max(each // bends, 1), reference_V, rng),
            noisy(one_V, each, reference_V, rng),
            noisy(two_V, each, reference_V, rng),
            noisy(weak_V, each, reference_V, rng),
        )


class Way:
    """One pipeline and its own count of frames, so that ways in turns never see a number twice.

    Args:
        frames: Makes payloads.
        pipeline: Takes them.
        voltages: (n, 104) V; shown over and over.
        wanted: Whether somebody subscribed.
    """

    def __init__(self, frames: Frames, pipeline: Pipeline, voltages: Array, *, wanted: bool = True) -> None:
        self._make, self._voltages, self._wanted, self._sequence = frames.payload, voltages, wanted, 0
        self.pipeline = pipeline
        self._ready = b""
        self.prepare(0)

    def prepare(self, index: int) -> None:
        """Make the payload of the next frame, which is no part of what is measured."""
        self._sequence += 1
        self._ready = self._make(self._voltages[index % len(self._voltages)], self._sequence)

    def __call__(self) -> bool:
        """Take the prepared frame through the pipeline, and do what waits for leisure when it is due."""
        pipeline = self.pipeline
        fit = pipeline.accept(self._ready, time.perf_counter_ns()) and pipeline.compute(self._wanted)
        pipeline.note_health()
        if pipeline.has_leisure_work:
            pipeline.look_at_health()
        return fit
