"""A frame of a run as a PNG file: the streamed map, with the truth below it, in the colours of the terminal's picture.

The map comes from a subscriber's record, the truth from the script at that frame's device time.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_proto.files.writing import write_bytes
from eitskin_tools.demo.recorder import Record
from eitskin_tools.pictures import palette, png

MIN_ANGLE_DEG: Final = 50.0
"""A frame worth showing is bent at least so far."""

ZOOM: Final = 12
"""Pixels of the picture a pixel of the map."""


def choose(record: Record, script: Any, start_us: int) -> tuple[int, float]:
    """Return (number of the kept map, its script time) of a bent frame with most touches and the median correlation.

    Raises:
        ValueError: No kept frame is bent and touched.
    """
    from eitskin_sim.evaluation.metrics import correlation

    first_us = int(record.device_us[0])
    times_s = ((first_us - start_us) % (1 << 32) + record.device_us - first_us)[:: record.stride] * 1e-6
    found = []
    for index, time_s in enumerate(times_s):
        scene = script.scene_at(time_s)
        if scene.touches and abs(scene.bend.angle_deg) >= MIN_ANGLE_DEG:
            found.append((len(scene.touches), index, time_s))
    if not found:
        raise ValueError(f"no frame of this record is touched and bent by {MIN_ANGLE_DEG:g} deg; record more seconds")
    most = max(count for count, _, _ in found)
    rated = [
        (correlation(record.maps[index].astype(np.float64), script.truth_at(time_s)), index, time_s)
        for count, index, time_s in found
        if count == most
    ]
    rated.sort()
    _, index, time_s = rated[len(rated) // 2]
    return index, float(time_s)


def picture(record: Record, script: Any, start_us: int, path: Path) -> None:
    """Draw one frame of a record into a PNG file.

    Args:
        record: What a subscriber noted.
        script: What the virtual skin played.
        start_us: Device clock when the script began.
        path: File to write.

    Raises:
        ValueError: The record has no frame worth drawing.
        OSError: The file cannot be written.
    """
    index, time_s = choose(record, script, start_us)
    colours, white = palette().astype(np.uint8), np.full((ZOOM, record.maps.shape[2] * ZOOM, 3), 255, np.uint8)
    maps = []
    for values in (record.maps[index], script.truth_at(time_s)):  # row 0 is at the bottom
        levels = np.rint(np.clip(values[::-1], 0.0, 1.0) * (len(colours) - 1)).astype(np.intp)
        maps.append(colours[np.kron(levels, np.ones((ZOOM, ZOOM), np.intp))])
    write_bytes(path, png(np.concatenate([maps[0], white, maps[1]])))
