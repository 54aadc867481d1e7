"""The data of one frame between its payload and its message: the pipeline fills it in, the packer reads it.

One record is made at the start and overwritten by every frame, so a frame allocates no object. It is filled in by::

    intake      sequence, device_us, scanned_ns, idle, first events       stamps: read, decode
    pipeline    touched, gate_logit, solver, skipped, map, totals ...     stamps: normalise, gate, infer
    packer      values known only while packing                          stamps: pack, publish

A caller that needs more than one frame of it copies what it needs.
"""

import math
from typing import Final

STAGES: Final = ("read", "decode", "normalise", "gate", "infer", "pack", "publish")
"""The end of each stage is stamped with ``perf_counter_ns``; read is when the last byte was in hand."""

READ, DECODE, NORMALISE, GATE, INFER, PACK, PUBLISH = range(len(STAGES))
"""Where each stage's stamp stands."""


class FrameRecord:
    """The frame in hand.

    Args:
        computed_map: 4 bytes a pixel, of float32, that solvers write to.
    """

    __slots__ = (
        "_computed_map", "_nothing", "cloud", "cloud_sequence", "corrupt", "device_us", "drift", "electrodes", "events",
        "fused", "gate_logit", "idle", "inferred", "lost", "map_sequence", "overrun", "resets", "scanned_ns",
        "sequence", "skipped", "solver", "stamps", "touched", "touches", "weak_rows", "withheld",
    )  # fmt: skip

    def __init__(self, computed_map: memoryview) -> None:
        self._computed_map = computed_map
        self._nothing = memoryview(bytes(computed_map.nbytes))
        self.stamps = [0] * len(STAGES)
        """``perf_counter_ns`` at the end of each of ``STAGES``."""
        self.sequence = 0
        """Of the device, unwrapped."""
        self.device_us = 0
        """Device clock at the end of the scan, unwrapped."""
        self.scanned_ns = 0
        """When it was scanned, on the host's clock."""
        self.idle = False
        """It is a scan of a few drives."""
        self.touched = False
        self.gate_logit = 0.0
        self.solver = "none"
        """Name of the engine whose map this is, or ``none``."""
        self.skipped: tuple[str, ...] = ()
        self.events: tuple[str, ...] = ()
        self.inferred = False
        """Whether an engine ran for this frame."""
        self.map_sequence = 0
        """The frame that the map was computed for."""
        self.fused = 1
        """Frames that the map rests on: that one, and those just before it."""
        self.electrodes: tuple[str, ...] = ()
        """Those that are not well."""
        self.drift = math.nan, math.nan, math.nan
        """Drift of the reference, in percent: the part common to all rows, its standard deviation, and the rms of the
        rest; not a number while unknown."""
        self.cloud = 0
        """Revision of the cloud in use."""
        self.cloud_sequence: int | None = None
        """The first frame that it was used for; None if it was there at the start."""
        self.weak_rows = 0
        self.lost = 0
        self.corrupt = 0
        self.withheld = 0
        self.overrun = 0
        self.resets = 0
        """Totals up to this frame."""
        self.touches: tuple[bytes, bytes, int] | None = None
        """Touches, their events, and how many are not listed (:mod:`eitskin.touches.watch`); None without a request."""

    @property
    def map_is_zero(self) -> bool:
        """Whether the map is all zero because nothing was computed."""
        return self.solver == "none"

    @property
    def map(self) -> memoryview:
        """The map as float32, little-endian; the next frame overwrites it."""
        return self._nothing if self.solver == "none" else self._computed_map

    @property
    def map_key(self) -> tuple[int, int]:
        """Identifies its map in this run, because a restarted device counts its frames from 0 again."""
        return self.resets, self.map_sequence

    def note(self, *events: str) -> None:
        """Add an event of this frame."""
        self.events += events
