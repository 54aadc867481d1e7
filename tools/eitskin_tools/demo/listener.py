"""A process that reads all streams and does nothing with them, to measure the cost of one subscriber."""

import argparse
import json
import math
import signal
import sys

import eitskin


def main() -> int:
    """Read all streams of a runtime until stopped, or until it is gone; report how much came."""
    parser = argparse.ArgumentParser(description="Take all streams of a runtime.")
    parser.add_argument("endpoint")
    arguments = parser.parse_args()
    ends = False

    def stop(*_: object) -> None:
        nonlocal ends
        ends = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    with eitskin.subscribe_streams(arguments.endpoint, timeout_s=math.inf) as streams:
        while not ends:
            try:
                streams.next_item(0.5)
            except eitskin.NoFrame:
                continue
            except eitskin.SkinError as error:
                print(f"{error}", file=sys.stderr)
                return 1
        print(json.dumps({"received": streams.received, "lost": streams.lost, "rejected": streams.rejected}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
