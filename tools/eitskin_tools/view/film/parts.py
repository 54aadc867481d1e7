"""A recording in parts of a second, each made when a page asks for it: surfaces and frames as a live page gets them.

Maps are computed from what was measured, by the sums that made them then (:mod:`eitskin.pipeline.maps_again`), so a
recording without maps is looked at as well as one with them, and with another bundle too. Where only noise had changed,
and the frame whose map stood lies before the part, its own map is computed. Touches are found anew; their numbers go on
from part to part while a page plays on, and begin anew where it jumped.
"""

import math
import threading
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from eitskin.model.bundle import Bundle
from eitskin.model.engine import default_solver
from eitskin.pipeline.maps_again import NOTHING
from eitskin.robot.pose import Pose
from eitskin.touches.surface import Surface
from eitskin.touches.touch import LAYOUT, unpack_touches
from eitskin.touches.watch import TouchWatch
from eitskin_tools.recording.bundles import bundle_of
from eitskin_tools.recording.reinfer.rerun import Rerun
from eitskin_tools.recording.script import Step
from eitskin_tools.recording.seek.moments import Moments
from eitskin_tools.view.film.noted import blank, published
from eitskin_tools.view.messages import frame_message, surface_message

PART_S: Final = 1.0
"""Of a recording, in one answer."""

MOST_BYTES: Final = 32 << 20
"""Parts that are kept for other pages, and for one that goes back."""

MOST_WATCHES: Final = 8
"""Ends of parts at which touches are known, so that the part behind goes on with their numbers."""


class Film:
    """A recording that is looked at; for any number of threads.

    Args:
        path: Of the file.
        bundle: What computes the maps; None for the one that was running, if it is a shipped one.

    Raises:
        SkinError: Recording or bundle cannot be used, with what to do.
        OSError: The file cannot be read.
    """

    def __init__(self, path: Path, bundle: Path | None = None) -> None:
        self._moments = Moments(path)
        self._bundle: Bundle = bundle_of(self._moments, bundle)
        self._rerun = Rerun(self._moments, self._bundle)
        self.path, self.skin = path, self._bundle.skin
        self.seconds = self._moments.seconds
        self.ending = self._moments.ending.removeprefix("; ")
        """What is wrong with the file, in words; "" if nothing is."""
        self.first_ns = self._moments.first_ns
        """Wall clock of the first frame."""
        self.parts = math.floor(self.seconds / PART_S) + 1
        self._lock = threading.Lock()
        self._made: OrderedDict[int, bytes] = OrderedDict()
        self._watches: OrderedDict[int, TouchWatch] = OrderedDict()
        self._flat = Surface(self.skin.grid.flat_cloud_mm(), self.skin.grid)
        self._nothing = np.zeros(self.skin.grid.shape, dtype=np.float32)
        self._solver, self._run = default_solver(self._bundle), self._moments.told("run")
        self._blank = blank(self._moments, self._nothing)

    def part(self, number: int) -> bytes:
        """Return the messages of a part, one behind the other.

        Args:
            number: From 0 to below ``parts``.

        Raises:
            SkinError: It cannot be computed.
            OSError: The file cannot be read any more.
        """
        with self._lock:
            if number not in self._made:
                self._made[number] = self._make(number)
                while len(self._made) > 1 and sum(map(len, self._made.values())) > MOST_BYTES:
                    self._made.popitem(last=False)
            self._made.move_to_end(number)
            return self._made[number]

    def _make(self, number: int) -> bytes:
        span = self._moments.span(number * PART_S, (number + 1) * PART_S)
        watch = self._watches.pop(number - 1, None) or TouchWatch(self.skin.grid)
        messages: list[bytes] = []
        surface, cloud = self._flat, 0
        kept, shown = self._nothing, -1
        for step in map(self._asked, span.steps):
            frame = step.frame
            if step.cloud is not None:
                cloud, surface = step.cloud.revision, Surface(step.cloud.cloud, self.skin.grid)
                messages.append(surface_message(cloud, step.cloud.cloud, self._run, 0, Pose()))
            stands = self._rerun.as_recorded and frame.map_seq == shown
            found = self._rerun.compute(step, every=not stands)
            if found is None or frame.seq is None:
                continue
            has_map = found.touched and found.solver != NOTHING
            if has_map and not stands:  # it stays while frames go out without one: a later one may have it
                kept, shown = found.map, frame.seq if frame.map_seq is None else frame.map_seq
            values = kept if has_map else self._nothing
            listed = watch.look(values.ravel().astype(float) if has_map else None, shown, surface, frame.device_us or 0)
            touches = unpack_touches(listed[0], LAYOUT.size, *listed[1:])
            note = span.notes.get(-1 if frame.frame is None else frame.frame, {})
            told = published(step, note, found, self.first_ns)
            messages.append(
                frame_message(replace(self._blank, **told, map=values, cloud=cloud, touch_list=touches), 0, Pose())
            )
        self._watches[number] = watch
        while len(self._watches) > MOST_WATCHES:
            self._watches.popitem(last=False)
        return b"".join(messages)

    def _asked(self, step: Step) -> Step:
        """Return a frame as it would be had somebody asked for its map: a recorder alone need not."""
        frame = step.frame
        if not frame.touched or frame.solver != NOTHING:
            return step
        return replace(step, frame=replace(frame, solver=self._solver, map_seq=frame.seq))
