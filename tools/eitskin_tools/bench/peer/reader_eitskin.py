"""Reads with eitskin's transport and framing; the same output as ``reader_flexitac.py``."""

import hashlib
import json
import sys
import time

from eitskin.acquisition.serial_port import SerialPort
from eitskin_proto.wire.framing import Deframer


def main(port: str, seconds: float) -> None:
    """Read until the time is over."""
    found = []
    line, deframer = SerialPort(port), Deframer()
    try:
        print("ready", flush=True)
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            payloads = deframer.feed(line.read(left))
            now = time.perf_counter_ns()
            found += [[now, hashlib.sha256(raw).hexdigest(), list(raw[:4])] for raw in payloads]
    finally:
        line.close()
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
