"""The sensor's process: prints its port, waits for a line, then sends frames at a rate and prints when each went out.

Frames that the line has no room for are dropped whole, as a sensor's would be, and have no time.
"""

import argparse
import json
import sys
import time

from eitskin_tools.bench.peer.frames import flipped, on_the_wire
from eitskin_tools.virtual_skin.pty import PtyPort


def main() -> int:
    """Run the sensor."""
    parser = argparse.ArgumentParser(description="Send numbered frames on a pseudo-terminal.")
    parser.add_argument("kind", choices=["flexitac", "eitskin"])
    parser.add_argument("--frames", type=int, required=True)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--flip", action="store_true", help="invert one bit of every frame")
    arguments = parser.parse_args()
    frames = [on_the_wire(number, arguments.kind) for number in range(arguments.frames)]
    if arguments.flip:
        frames = [flipped(frame, number) for number, frame in enumerate(frames)]
    sent_ns: list[int | None] = []
    with PtyPort() as port:
        print(port.path, flush=True)
        sys.stdin.readline()
        start = time.perf_counter()
        for number, frame in enumerate(frames):
            time.sleep(max(start + number / arguments.rate - time.perf_counter(), 0.0))
            now = time.perf_counter_ns()
            sent_ns.append(now if port.write(frame) else None)
        while port.unsent:
            port.flush()
            time.sleep(0.001)
        print(json.dumps(sent_ns), flush=True)
        sys.stdin.readline()  # the port stays until the reader is done
    return 0


if __name__ == "__main__":
    sys.exit(main())
