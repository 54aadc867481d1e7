"""A recording as one picture: its strongest maps, and its touches and drift over time."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin.messaging.frame import Frame
from eitskin.model.bundle import Bundle
from eitskin_tools.pictures import draw_map, save
from eitskin_tools.recording.frames import RecordedFrames
from eitskin_tools.recording.layout import RecordingError
from eitskin_tools.recording.script import Script

MAPS: Final = 4
"""Maps in the picture: the strongest of each quarter of the time."""

PROGRESS_FRAMES: Final = 200
"""Between two reports of the progress."""

NAN: Final = float("nan")

LEGEND: Final[dict[str, Any]] = {
    "loc": "lower right", "bbox_to_anchor": (1.0, 0.98), "ncols": 2, "frameon": False, "fontsize": 8,
}  # fmt: skip
"""Above the axes, where it hides no data."""


@dataclass(slots=True)
class Course:
    """What a recording shows over time; a list has one value for each frame unless it says otherwise."""

    begin_s: float
    end_s: float
    times_s: list[float] = field(default_factory=list)
    """Since the first frame of the recording."""
    touches: list[int] = field(default_factory=list)
    """How many there are."""
    areas_mm2: list[float] = field(default_factory=list)
    """Of all touches together, on the flat sheet."""
    drifts_percent: list[float] = field(default_factory=list)
    """NaN where it was not recorded."""
    drift_sds_percent: list[float] = field(default_factory=list)
    """Standard deviation of the drift."""
    places: list[tuple[float, float, float]] = field(default_factory=list)
    """Time in s, x and y in mm of each touch of each frame."""
    strongest: dict[int, Frame] = field(default_factory=dict)
    """The frame with the largest sum of its map, by the quarter of the time."""

    def add(self, frame: Frame) -> None:
        """Take a frame, in order."""
        at_s = 1e-9 * frame.received_ns
        touches = frame.touch_list.touches if frame.touch_list else ()
        self.times_s.append(at_s)
        self.touches.append(len(touches))
        self.areas_mm2.append(sum(touch.area_mm2 for touch in touches))
        self.drifts_percent.append(NAN if frame.drift_percent is None else frame.drift_percent)
        self.drift_sds_percent.append(NAN if frame.drift_sd_percent is None else frame.drift_sd_percent)
        self.places += [(at_s, *touch.centre_mm) for touch in touches]
        share = (at_s - self.begin_s) / max(self.end_s - self.begin_s, 1e-9)
        quarter = min(int(MAPS * share), MAPS - 1)
        before = self.strongest.get(quarter)
        if frame.map.any() and (before is None or frame.map.sum() > before.map.sum()):
            self.strongest[quarter] = frame


def course_of(
    script: Script,
    bundle: Bundle,
    from_s: float | None = None,
    to_s: float | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Course:
    """Compute the maps and touches of a recording, or of a part of it.

    Args:
        script: The recording.
        bundle: Computes the maps.
        from_s: Begin so long after the first frame.
        to_s: End so long after it.
        progress: Called with the seconds done and all seconds.

    Raises:
        RecordingError: The part has no frame with a map.
        SkinError: The recording cannot be used with the bundle.
        OSError: The file cannot be read any more.
    """
    begin_s, end_s = from_s or 0.0, min(script.seconds, script.seconds if to_s is None else to_s)
    course, frames = Course(begin_s, end_s), RecordedFrames(script, bundle)
    for step, frame in frames.part(from_s, to_s, frames.watch()):
        if frame is not None:
            course.add(frame)
        if progress is not None and step.frame.n % PROGRESS_FRAMES == 0:
            progress(1e-9 * (step.log_ns - script.first_ns) - begin_s, end_s - begin_s)
    if not course.times_s:
        part = f"from {begin_s:g} s" + ("" if to_s is None else f" to {to_s:g} s")
        raise RecordingError(f"{script.path} has no frame to draw {part}; it lasts {script.seconds:.1f} s")
    return course


def draw(path: Path, course: Course, title: str, size_mm: tuple[float, float]) -> None:
    """Draw what a recording shows.

    Args:
        path: Of the picture.
        course: What it shows.
        title: Above everything.
        size_mm: Length and width of the sheet.

    Raises:
        OSError: The picture cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure: Any = Figure(figsize=(10.0, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=10)
    above, below = figure.subfigures(2, 1, height_ratios=(1.0, 3.2))
    _draw_maps(above, course, size_mm)
    number, area, places, drift = below.subplots(4, 1, sharex=True)
    number.step(course.times_s, course.touches, where="post")
    number.set_ylabel("touches")
    number.yaxis.get_major_locator().set_params(integer=True)
    area.plot(course.times_s, course.areas_mm2)
    area.set_ylabel("area of all\ntouches (mm²)")
    _draw_places(places, course, size_mm)
    _draw_drift(drift, course)
    drift.set_xlabel("time since the first frame of the recording (s)")
    for axes in (number, area, places, drift):
        axes.grid(visible=True, alpha=0.3)
    save(figure, path, dpi=120)


def _draw_maps(figure: Any, course: Course, size_mm: tuple[float, float]) -> None:
    """Draw the strongest maps, with a cross on each touch."""
    if not course.strongest:
        figure.text(0.5, 0.5, "nothing touched the sheet", ha="center", va="center")
        return
    image: Any = None
    grid = figure.subplots(1, MAPS)
    for axes in grid:
        axes.set_axis_off()
    for axes, (_, frame) in zip(grid, sorted(course.strongest.items()), strict=False):
        image = draw_map(axes, frame.map, f"{1e-9 * frame.received_ns:.2f} s, frame {frame.sequence}", size_mm)
        for touch in frame.touch_list.touches if frame.touch_list else ():
            axes.plot(*touch.centre_mm, "+", color="white", markersize=8)
    figure.colorbar(image, ax=list(grid), label="map", shrink=0.8)


def _draw_places(axes: Any, course: Course, size_mm: tuple[float, float]) -> None:
    """Draw x and y of the touches' centres over time."""
    for index, name in ((1, "x"), (2, "y")):
        axes.plot(
            [place[0] for place in course.places], [place[index] for place in course.places], ".", ms=3, label=name
        )
    axes.set_ylim(0.0, max(size_mm))
    axes.set_ylabel("centres of\ntouches (mm)")
    axes.legend(**LEGEND)


def _draw_drift(axes: Any, course: Course) -> None:
    """Draw the drift with its standard deviation."""
    axes.set_ylabel("drift (%)")
    drift, sd = np.array(course.drifts_percent), np.array(course.drift_sds_percent)
    if np.isnan(drift).all():
        axes.text(0.5, 0.5, "no drift recorded", transform=axes.transAxes, ha="center", va="center")
        return
    axes.fill_between(course.times_s, drift - sd, drift + sd, alpha=0.3, label="± standard deviation")
    axes.plot(course.times_s, drift, label="drift")
    axes.legend(**LEGEND)
