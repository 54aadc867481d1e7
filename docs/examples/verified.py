"""A robot that acts on verified touches only: never on one that physics cannot explain, and not while nobody checks.

    python docs/examples/verified.py [ENDPOINT]

The runtime must verify: ``eitskin run --verify always``. Replace ``act`` and ``wait`` by your robot's own calls.
"""

import sys
from contextlib import suppress

import eitskin


def act(place_mm: tuple[float, float, float], strength_mm2: float) -> None:
    """Stand in for what the robot does where it is touched."""
    print("act at", " ".join(f"{value:.1f}" for value in place_mm), f"mm, strength {strength_mm2:.0f} mm2")


def wait(why: str) -> None:
    """Stand in for what it does while it cannot be sure."""
    print(f"wait: {why}")


def main(endpoint: list[str]) -> None:
    """Act until Ctrl-C."""
    with eitskin.subscribe_verified(*endpoint, frames=False, timeout_s=3.0) as verdicts:
        while True:
            try:
                found = verdicts.next_verified()
            except eitskin.NoFrame as error:
                wait(str(error))
                continue
            if found.touches is None:
                if found.state != "ready" or found.why:
                    wait(f"{found.state} {found.why}".strip())
            elif found.flagged:
                wait(f"frame {found.sequence} is flagged: {found.why}, p {found.p_value:.2g}")
            else:
                for touch in found.touches:
                    act(touch.place_mm, touch.strength_mm2)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(sys.argv[1:2])
