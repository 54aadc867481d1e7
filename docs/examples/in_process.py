"""Read a skin without a second process: the runtime as a library.

    python docs/examples/in_process.py PORT

The sheet must be flat and untouched when the program starts, because the program then captures the reference. One
thread computes all frames. Set OPENBLAS_NUM_THREADS=1 if numpy must not use all cores for the program's own arrays.
"""

import sys
from contextlib import suppress

import eitskin

if len(sys.argv) != 2:
    sys.exit(__doc__)

with eitskin.Skin(sys.argv[1]) as skin:
    reference = skin.capture_reference(frames=50)
    print(f"reference of {reference.frames} frames from {reference.serial_number}, weak rows {reference.weak.size}")
    with suppress(KeyboardInterrupt):
        for frame in skin.frames(timeout_s=5.0):
            if frame.touched:
                row, column = divmod(int(frame.map.argmax()), frame.map.shape[1])
                print(f"touched at x {(column + 0.5) * 10 / 3:.1f} mm, y {(row + 0.5) * 10 / 3:.1f} mm")
    status = skin.status()
    print(f"{status['frames']} frames, {status['lost']} lost")
