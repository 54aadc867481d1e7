"""Reads with flexitac's own package; run by the interpreter of its virtual environment, so it imports nothing of ours.

Usage: peer_flexitac.py PORT SECONDS read|read_latest. Prints one JSON list: [host time in ns, digest of the frame's
bytes, their first four] for every frame that flexitac returns.
"""

import hashlib
import json
import sys
import time

from flexitac import FlexiTacSensor


def main(port: str, seconds: float, method: str) -> None:
    """Read until the time is over."""
    found = []
    # A scalar baseline: learning one would read frames before the first is returned, and so age them.
    with FlexiTacSensor(port, baseline=20.0, read_timeout_s=0.5) as sensor:
        print("ready", flush=True)
        end = time.perf_counter() + seconds
        take = getattr(sensor, method)
        while time.perf_counter() < end:
            try:
                raw = take().raw.tobytes()
            except TimeoutError:
                continue
            found.append([time.perf_counter_ns(), hashlib.sha256(raw).hexdigest(), list(raw[:4])])
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), sys.argv[3])
