"""Honest frames, drawn: the demonstration's sheet through front ends of two widths, with all kinds of noise."""

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin.health.monitor import health_of
from eitskin.model.bundle import load_bundle
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.builder import ReferenceBuilder
from eitskin.reference.normaliser import Normaliser
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.wire.frames import Frame, full_scale, quantise
from eitskin_proto.wire.messages import Hello

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int32]

PERIOD_NS = 5_000_000
CONVERTER_V = 2.5
GAINS = {3: 8.0, 2: 8.0, 4: 1.0}
"""Sample bytes and the gain that goes with them; volts of a count follow."""


@cache
def _script() -> tuple[Any, Any]:
    from eitskin_tools.scripted_scene.script import demonstration, prepare

    script = demonstration()
    return script, prepare(script, script.period_s)


@dataclass
class Sheet:
    """One sheet behind one front end; frames are asked for by time.

    Args:
        seed: Of its noise.
        kind: Of its noise.
        snr_db: Of its noise.
        sample_bytes: Of its converter.
        gone: Electrodes whose rows read next to nothing.
        silent: Whether those rows read exactly nothing.
        overdrive: Factor by which the gain is too high.
        drifts: Whether all rows drift by some percent, and unevenly by less.
    """

    seed: int
    kind: str = "N2"
    snr_db: float = 52.0
    sample_bytes: int = 3
    gone: tuple[int, ...] = ()
    silent: bool = False
    overdrive: float = 1.0
    drifts: bool = False
    volts_per_count: float = field(init=False)

    def __post_init__(self) -> None:
        from eitskin_tools.virtual_skin.process import Noise

        self._script, self._solved = _script()
        self._samples = 0
        self.rng = np.random.default_rng(self.seed)
        self.volts_per_count = CONVERTER_V / GAINS[self.sample_bytes] / full_scale(self.sample_bytes) / self.overdrive
        flat = self._script.voltages_at(0.0, self._solved)
        self._noise = Noise(self.kind, self.snr_db, self.seed, flat, self.volts_per_count)

    @property
    def period_s(self) -> float:
        """Of the script."""
        return float(self._script.period_s)

    def hello(self, serial_number: str) -> Hello:
        """Return what the front end says of itself."""
        return Hello(
            firmware_version=(1, 0, 0), hardware_id=1, serial_number=serial_number, configuration_digest=1,
            generation=0, configuration_name="attack", rate_mHz=200_000, rows=104, sample_bytes=self.sample_bytes,
            volts_per_count=self.volts_per_count,
        )  # fmt: skip

    def sample(self, time_s: float) -> tuple[Counts, int]:
        """Return (104,) counts at a time of the script, 0 being flat and untouched, and which rows are cut off."""
        self._samples += self.drifts
        drift = 0.03 * np.sin(self._samples / 3000.0) + 0.005 * np.sin(self._samples / 5000.0 + np.arange(104))
        volts = self._noise.on(self._script.voltages_at(time_s, self._solved) * (1.0 + drift * self.drifts))
        if self.gone:
            rows = rows_of(self.gone)
            volts[rows] = 0.0 if self.silent else 2.0 * self.volts_per_count * self.rng.standard_normal(int(rows.sum()))
        return quantise(volts, self.volts_per_count, self.sample_bytes)


class Judge:
    """A pipeline that has captured its reference of a sheet; says of each frame whether it is withheld, and why."""

    def __init__(self, sheet: Sheet, frames: int = 100) -> None:
        simulated = sheet.kind == "none"  # without noise, which a reference shows only by --force
        hello = sheet.hello("HONEST-1")
        bundle = load_bundle()
        self.sheet = sheet
        self.pipeline = Pipeline(bundle, hello, health=health_of(bundle))
        self.named: set[str] = set()
        """Rows that were said to hang."""
        self.pipeline.start_with(GeometryGraph(bundle).geometry(None, None, 0))
        builder, normaliser = ReferenceBuilder(frames), Normaliser(sheet.volts_per_count)
        taken = False
        while not taken:
            counts, _ = sheet.sample(0.0)
            normaliser.load(counts)
            taken = builder.add(normaliser.voltages())
        self.pipeline.use_reference(builder.finish(hello, force=simulated))
        self.sequence = 0

    @property
    def fills(self) -> bool:
        """Whether rows that were named are filled in."""
        health = self.pipeline.health  # rows that noise hides in the reference are filled in for good
        return health is not None and bool(health.electrodes.findings or health.hanging_count)

    def passes(self, counts: Counts, saturation: int = 0) -> bool:
        """Return whether a frame of these counts would be published."""
        self.sequence += 1
        packed = Frame(
            sequence=self.sequence, device_us=self.sequence * PERIOD_NS // 1000 % (1 << 32), counts=counts,
            sample_bytes=self.sheet.sample_bytes, saturation=saturation,
        ).pack()  # fmt: skip
        pipeline = self.pipeline
        done = pipeline.accept(packed, self.sequence * PERIOD_NS) and pipeline.compute(False)
        if done:
            pipeline.keep_for_health()
            self.named.update(event for event in pipeline.record.events if event.startswith("rows:"))
        if pipeline.has_leisure_work:
            pipeline.check_health()
        return done
