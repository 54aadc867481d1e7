"""Print what the skin feels: the newest frame, again and again, until Ctrl-C.

    python docs/examples/subscribe.py [ENDPOINT]

A runtime must be running: ``eitskin run`` or ``eitskin demo``. Without an endpoint its default one is used.
"""

import sys
from contextlib import suppress

import eitskin

with suppress(KeyboardInterrupt), eitskin.subscribe(*sys.argv[1:2], timeout_s=10.0) as frames:
    for frame in frames:
        state = f"touched, highest pixel {frame.map.max():.2f}" if frame.touched else "untouched"
        print(f"frame {frame.sequence}: {state}, {1e3 * frame.age_s:.1f} ms old, solver {frame.solver}")
