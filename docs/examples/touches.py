"""Print touches without maps: place and normal on the bent surface, area, and when each comes and goes.

    python docs/examples/touches.py [ENDPOINT]

Maps give neither force nor strength. Verified touches have a strength: see verified.py.
"""

import sys
from contextlib import suppress

import eitskin

with suppress(KeyboardInterrupt), eitskin.subscribe(*sys.argv[1:2], mode="all", maps=False, timeout_s=10.0) as frames:
    for frame in frames:
        for event in frame.touch_list.events:
            print(f"frame {frame.sequence}: touch {event.id} {event.kind}")
        for touch in frame.touches:
            x, y, z = touch.place_mm
            facing = " ".join(f"{part:.2f}" for part in touch.normal)
            print(f"touch {touch.id} at {x:.1f} {y:.1f} {z:.1f} mm, facing {facing}, {touch.area_mm2:.0f} mm2")
