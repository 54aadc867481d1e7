"""Print a part of the sheet, and skip maps in which only noise changed.

    python docs/examples/region.py [ENDPOINT]

The runtime computes whole maps. It neither computes nor sends a map if only noise has changed since the previous one.
"""

import sys
from contextlib import suppress

import eitskin

LEFT_EDGE_MM = (0.0, 0.0, 30.0, 100.0)  # x0, y0, x1, y1 on the flat sheet

with (
    suppress(KeyboardInterrupt),
    eitskin.subscribe(*sys.argv[1:2], region_mm=LEFT_EDGE_MM, skip_unchanged=True, timeout_s=10.0) as frames,
):
    for frame in frames:
        part = frame.map[frames.region.slices]  # rows and columns of the rectangle
        print(f"left edge {part.shape}: highest pixel {part.max():.2f}")
