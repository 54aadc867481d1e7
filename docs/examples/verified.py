"""A robot that acts only on verified touches whose places in space are known, and else waits.

    python docs/examples/verified.py [ENDPOINT]

The runtime must verify: ``eitskin run --verify always``. Call your own robot in ``act`` and ``wait``.
"""

import sys
from contextlib import suppress

import eitskin


def act(place_mm: tuple[float, float, float], strength_mm2: float) -> None:
    """Stand in for the robot's action at a touch."""
    print("act at", " ".join(f"{value:.1f}" for value in place_mm), f"mm, strength {strength_mm2:.0f} mm2")


def wait(why: str) -> None:
    """Stand in for the robot's action while touches are uncertain."""
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
            elif found.why == "fitted":
                wait(f"frame {found.sequence}: places in space are unknown; send the sheet's cloud")
            else:
                for touch in found.touches:
                    act(touch.place_mm, touch.strength_mm2)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(sys.argv[1:2])
