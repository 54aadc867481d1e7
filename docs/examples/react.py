"""A robot that reacts: it moves until it is touched, says where, and goes on once it is let go.

    python docs/examples/react.py [ENDPOINT]

It also stops when it does not know: no frame in time, or only an old one. Replace ``drive`` by your robot's own call.
"""

import sys
from contextlib import suppress

import numpy as np

import eitskin

PIXEL_MM = 10 / 3
CALM_FRAMES = 20
"""Untouched frames in a row before it moves again: 0.1 s at 200 frames/s, if it keeps up."""


def drive(speed: float) -> None:
    """Stand in for a robot's drive: 1 is full speed, 0 is stop."""
    print("go" if speed else "stop")


def centre_mm(touched_map: np.ndarray) -> tuple[float, float]:
    """Return x and y of the middle of what is touched, on the flat sheet."""
    weights = np.where(touched_map >= 0.5, touched_map, 0.0)
    if not weights.any():
        weights = touched_map
    rows, columns = np.indices(touched_map.shape)
    x, y = ((index + 0.5) * weights for index in (columns, rows))
    return PIXEL_MM * float(x.sum() / weights.sum()), PIXEL_MM * float(y.sum() / weights.sum())


def main(endpoint: list[str]) -> None:
    """React until Ctrl-C."""
    moving, blind, calm = False, False, 0
    with eitskin.subscribe(*endpoint, timeout_s=0.5, max_age_s=0.2) as frames:
        while True:
            try:
                frame = frames.next_frame()
            except (eitskin.NoFrame, eitskin.StaleFrame) as error:
                if not blind:
                    print(f"blind: {error}")
                    drive(0.0)
                moving, blind, calm = False, True, 0
                continue
            blind = False
            touched = frame.touched and frame.map.max() > 0.5
            calm = 0 if touched else calm + 1
            if moving and touched:
                moving = False
                drive(0.0)
                print("touched at x {:.0f} mm, y {:.0f} mm".format(*centre_mm(frame.map)))
            elif not moving and calm >= CALM_FRAMES:
                moving = True
                drive(1.0)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(sys.argv[1:2])
