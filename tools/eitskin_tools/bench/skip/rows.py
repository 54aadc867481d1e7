"""The skips of the frame loop, one function each: CPU saved a frame, and what subscribers lose by it."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin.model.geometry import GeometryGraph
from eitskin_tools.bench.skip.cost import interleaved, saving
from eitskin_tools.bench.skip.frames import Frames, Material, Way

Array = npt.NDArray[np.float64]


def costs(bundle: Bundle, shown: Material, count: int) -> dict[str, Any]:
    """Return the rows of all skips that need no device.

    Args:
        bundle: What is deployed.
        shown: What the pipelines are shown.
        count: Frames of each way; a tenth of it where the geometry graph runs for each.
    """
    frames, touched_V = shown.frames, shown.one_V
    found = {}
    if bundle.gate_arrays() is not None:
        found["untouched"] = untouched(bundle, frames, shown.bent_V, touched_V, count)
    found["cloud_unchanged"] = cloud_unchanged(bundle, frames, touched_V, max(count // 10, 20))
    found["no_subscriber"] = no_subscriber(bundle, frames, touched_V, count)
    found["unchanged"] = unchanged(bundle, frames, touched_V, shown.two_V)
    return found


def untouched(bundle: Bundle, frames: Frames, bent_V: Array, touched_V: Array, count: int) -> dict[str, Any]:
    """Return the row of "nothing touched", beside what a touched frame costs."""
    files = {name: data for name, data in bundle.files.items() if name != "gate.npz"}
    without = replace(bundle, files=files)
    ways = {
        "with": Way(frames, frames.pipeline(bundle), bent_V),
        "without": Way(frames, frames.pipeline(without), bent_V),
        "touched": Way(frames, frames.pipeline(bundle), touched_V),
    }
    row = saving(interleaved(dict(ways), count))
    row["untouched_to_touched"] = round(row["us"]["with"]["cpu_mean"] / row["us"]["touched"]["cpu_mean"], 4)
    return row


class Redone(Way):
    """A way that runs the geometry graph for every frame."""

    def __init__(self, frames: Frames, bundle: Bundle, voltages: Array) -> None:
        super().__init__(frames, frames.pipeline(bundle), voltages)
        self._graph, self._cloud = GeometryGraph(bundle), bundle.skin.grid.flat_cloud_mm()

    def __call__(self) -> bool:
        """Take the prepared frame."""
        self.pipeline.start_with(self._graph.geometry(self._cloud, None, 1))
        return super().__call__()


def cloud_unchanged(bundle: Bundle, frames: Frames, touched_V: Array, count: int) -> dict[str, Any]:
    """Return the row of "cloud unchanged": the map is the same to the last bit."""
    kept = Way(frames, frames.pipeline(bundle), touched_V)
    kept.pipeline.start_with(GeometryGraph(bundle).geometry(bundle.skin.grid.flat_cloud_mm(), None, 1))
    redone = Redone(frames, bundle, touched_V)
    row = saving(interleaved({"with": kept, "without": redone}, count))
    return {**row, "largest_map_error": _largest(kept, redone)}


def no_subscriber(bundle: Bundle, frames: Frames, touched_V: Array, count: int) -> dict[str, Any]:
    """Return the row of "nobody subscribed"; whoever subscribes gets the next frame's map, as if always there."""
    alone = Way(frames, frames.pipeline(bundle), touched_V, wanted=False)
    watched = Way(frames, frames.pipeline(bundle), touched_V)
    row = saving(interleaved({"with": alone, "without": watched}, count))
    return {**row, "largest_map_error": _largest(Way(frames, alone.pipeline, touched_V), watched)}


def unchanged(bundle: Bundle, frames: Frames, resting_V: Array, changed_V: Array) -> dict[str, Any]:
    """Return the row of "map unchanged": a touch at rest, then a second one beside it.

    Args:
        bundle: What is deployed.
        frames: Makes payloads.
        resting_V: (n, 104) noisy frames of one touch.
        changed_V: (m, 104) noisy frames of two.
    """
    stream = np.concatenate([resting_V, changed_V])
    kept = Way(frames, frames.pipeline(bundle, skip_unchanged=True), stream)
    computed = Way(frames, frames.pipeline(bundle), stream)
    row = saving(interleaved({"with": kept, "without": computed}, len(stream)))
    kept = Way(frames, frames.pipeline(bundle, skip_unchanged=True), stream)
    computed = Way(frames, frames.pipeline(bundle), stream)
    likeness, fresh = [], []
    for index in range(len(stream)):
        for way in (kept, computed):
            way.prepare(index)
            way()
        fresh.append(kept.pipeline.record.inferred)
        likeness.append(float(np.corrcoef(kept.pipeline.buffers.map[0], computed.pipeline.buffers.map[0])[0, 1]))
    first = len(resting_V)
    late = np.flatnonzero(fresh[first:])
    row["share_skipped_at_rest"] = round(1.0 - float(np.mean(fresh[1:first])), 4)
    row["cc_with_computed_map"] = {"mean": float(np.mean(likeness)), "least": float(np.min(likeness))}
    row["frames_until_change_is_seen"] = int(late[0]) if len(late) else None
    return row


def _largest(one: Way, other: Way, count: int = 20) -> float:
    """Return the largest difference of two ways' maps over the same frames."""
    largest = 0.0
    for index in range(count):
        for way in (one, other):
            way.prepare(index)
            way()
        difference = one.pipeline.buffers.map[0] - other.pipeline.buffers.map[0]
        largest = max(largest, float(np.abs(difference).max()))
    return largest
