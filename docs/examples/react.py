"""A robot that reacts: it moves until something touches it, prints the place, and moves on after the release.

    python docs/examples/react.py [ENDPOINT]

It also stops when it is blind: no frame came in time, or only an old one. Call your own robot in ``drive``.
"""

import sys
from contextlib import suppress

import eitskin

CALM_FRAMES = 20
"""Untouched frames in a row before it moves again: 0.1 s at 200 frames/s."""


def drive(speed: float) -> None:
    """Stand in for a robot's drive: 1 is full speed, 0 is stop."""
    print("go" if speed else "stop")


def main(endpoint: list[str]) -> None:
    """React until Ctrl-C."""
    moving, blind, calm = False, False, 0
    with eitskin.subscribe(*endpoint, maps=False, timeout_s=0.5, max_age_s=0.2) as frames:
        while True:
            try:
                touches = frames.next_frame().touches
            except (eitskin.NoFrame, eitskin.StaleFrame) as error:
                if not blind:
                    print(f"blind: {error}")
                    drive(0.0)
                moving, blind, calm = False, True, 0
                continue
            blind = False
            calm = 0 if touches else calm + 1
            if moving and touches:
                moving = False
                drive(0.0)
                x, y = max(touches, key=lambda touch: touch.area_mm2).centre_mm
                print(f"touched at x {x:.0f} mm, y {y:.0f} mm")
            elif not moving and calm >= CALM_FRAMES:
                moving = True
                drive(1.0)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(sys.argv[1:2])
