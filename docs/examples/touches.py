"""Touches without maps: where each is on the bent surface, which way that faces, how large, when it comes and goes.

    python docs/examples/touches.py [ENDPOINT]

No force is measured, and a map tells no strength. Verified touches have one: see verified.py.
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
