"""Read frames with pyzmq and msgpack alone, as a program in any other language would.

    python docs/examples/without_eitskin.py ENDPOINT

firmware_proto/SPEC.md, section 7, lists every field.
"""

import struct
import sys
import time
from contextlib import suppress

import msgpack
import zmq

if len(sys.argv) != 2:
    sys.exit(__doc__)

socket = zmq.Context().socket(zmq.SUB)
socket.setsockopt(zmq.CONFLATE, 1)  # keep the newest frame only; it must be set before connect
socket.setsockopt(zmq.SUBSCRIBE, b"\xde\x00")  # every frame begins with these bytes; it has one part and no topic
socket.connect(sys.argv[1])

with suppress(KeyboardInterrupt):
    while True:
        frame = msgpack.unpackb(socket.recv())
        if frame["v"] != 1:
            continue  # from a newer runtime
        rows, columns = frame["shape"]
        pixels = struct.unpack(f"<{rows * columns}f", frame["map"])  # row by row from the corner (0, 0)
        # Clocks compare on the same machine only; elsewhere count from the frame's arrival.
        age_ms = frame["age_us"] / 1e3 + (time.perf_counter_ns() - frame["host_ns"]["publish"]) / 1e6
        place = divmod(max(range(len(pixels)), key=pixels.__getitem__), columns)
        print(f"frame {frame['seq']}: highest pixel {max(pixels):.2f} at row, column {place}, {age_ms:.1f} ms")
