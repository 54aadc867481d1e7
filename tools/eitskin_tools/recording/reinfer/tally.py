"""What a recording's frames are, computed once more: bit by bit against what was published, and against another solver.

Of a published frame the recording keeps a digest of its map. A map that only noise separates from the one before was
published again as it was: then the digest is that of the earlier frame, which ``map_seq`` names.
"""

from collections import Counter, OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.messaging.streams.measured import WireFrame
from eitskin_tools.recording.codec import digest_of
from eitskin_tools.recording.reinfer.rerun import NOTHING, Computed

REMEMBERED: Final = 256
"""Digests of maps that a later frame may have been published with: a map is made anew every 100 frames at least."""

UNKNOWN: Final = {
    "no_conditions": "came before the file says what they were held against",
    "before_file": "have a map that was kept from before the file",
    "frame_missing": "have a map of a frame that the file lacks",
    "region": "differ in a last bit at most: an earlier release computed some rectangles of them alone",
}
"""Why it cannot be told of a published map whether it is equal; and what people read."""

BOTH: Final = 0.5
"""A pixel above it is touched."""


@dataclass(slots=True)
class Equality:
    """Counts published maps that come out the same."""

    published: int = 0
    """Frames that were published, with a digest."""
    equal: int = 0
    unknown_why: Counter[str] = field(default_factory=Counter)
    """Of which it cannot be told, by a key of ``UNKNOWN``."""
    differing: Counter[str] = field(default_factory=Counter)
    """Why the others are not equal: ``gate``, its value is another one; ``map``."""
    first_differing: int | None = None
    """``seq`` of the first of them."""
    _digests: OrderedDict[int, str] = field(default_factory=OrderedDict)
    _zero: str = ""
    _first: int | None = None
    _first_known: int | None = None

    @property
    def unknown(self) -> int:
        """Frames of which it cannot be told."""
        return self.unknown_why.total()

    def computed(self, sequence: int, found: Computed) -> None:
        """Take what a frame came to."""
        self._know_zero(found)
        self._digests[sequence] = self._zero if found.solver == NOTHING else digest_of(found.map)
        if len(self._digests) > REMEMBERED:
            self._digests.popitem(last=False)

    def published_as(self, frame: WireFrame, digest: str, found: Computed | None) -> None:
        """Hold a published frame's digest against what was computed.

        Args:
            frame: Of the wire.
            digest: Of the map that was published.
            found: What the frame came to; None where nothing could be computed.
        """
        self.published += 1
        if self._first is None:
            self._first = frame.seq
        if found is not None:
            self._know_zero(found)
            if self._first_known is None:
                self._first_known = frame.seq
        ours = (
            self._zero if frame.solver == NOTHING else self._digests.get(-1 if frame.map_seq is None else frame.map_seq)
        )
        if found is None or ours is None:
            self.unknown_why[self._why_unknown(frame, found)] += 1
        elif found.gate_logit is not None and found.gate_logit != frame.gate_logit:
            self._differs("gate", frame)
        elif ours == digest:
            self.equal += 1
        elif not found.is_whole:
            self.unknown_why["region"] += 1
        else:
            self._differs("map", frame)

    def _why_unknown(self, frame: WireFrame, found: Computed | None) -> str:
        if found is None or frame.map_seq is None or self._first is None or self._first_known is None:
            return "no_conditions"
        if frame.map_seq < self._first:
            return "before_file"
        return "no_conditions" if frame.map_seq < self._first_known else "frame_missing"

    def _know_zero(self, found: Computed) -> None:
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


def told_of_unknown(found: Mapping[str, Any]) -> str:
    """Return what people read of maps that cannot be told, as a clause; "" if there are none.

    Args:
        found: ``unknown`` and ``unknown_why``, of one file or of several.
    """
    if not found["unknown"]:
        return ""
    why = ", ".join(f"{count} {UNKNOWN[name]}" for name, count in found["unknown_why"].items())
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

    def add(self, one: Computed, other: Computed) -> None:
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
    weights = np.where(values > BOTH, values, 0.0).astype(np.float64)
    total = float(weights.sum())
    if not total:
        return None
    rows, columns = np.indices(values.shape)
    x_mm = float((weights * (columns + 0.5)).sum()) / total * pixel_mm[0]
    return np.array([x_mm, float((weights * (rows + 0.5)).sum()) / total * pixel_mm[1]])


def _quantile(values: list[float], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None
