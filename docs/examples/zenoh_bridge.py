"""Carry a runtime's touches over Zenoh, to programs that need no key of the runtime.

    pip install eclipse-zenoh
    python docs/examples/zenoh_bridge.py out [ENDPOINT]
    python docs/examples/zenoh_bridge.py in

``out`` publishes each touch message as it is (firmware_proto/SPEC.md, section 7). ``in`` prints what arrives, and every
200 messages the time since publishing; it runs on any machine, but knows the time on the same machine only.

Zenoh finds its peers by multicast and encrypts nothing unless its configuration says so: ZENOH_CONFIG names its file.
"""

import os
import sys
import time
from contextlib import suppress

import msgpack
import zenoh
import zmq

from eitskin.messaging.endpoints import default_publish

KEY = "eitskin/touches"


def send(session: zenoh.Session, endpoint: str) -> None:
    """Publish what the runtime publishes."""
    publisher = session.declare_publisher(KEY)
    socket = zmq.Context().socket(zmq.SUB)
    socket.subscribe(b"\xdf")
    socket.connect(endpoint)
    while True:
        publisher.put(socket.recv())


def receive(session: zenoh.Session) -> None:
    """Print the newest message, and leave older ones alone."""
    subscriber, late_ms = session.declare_subscriber(KEY, zenoh.handlers.RingChannel(1)), []
    while True:
        frame = msgpack.unpackb(subscriber.recv().payload.to_bytes())
        if frame["v"] != 2:
            continue  # from a newer runtime
        late_ms.append(1e-6 * (time.perf_counter_ns() - frame["host_ns"]["publish"]))
        print(f"frame {frame['seq']}: {len(frame.get('touches', b'')) // frame.get('touch_bytes', 92)} touches")
        if len(late_ms) == 200:
            late_ms.sort()
            print(f"since publishing: p50 {late_ms[100]:.3f} ms, p99 {late_ms[198]:.3f} ms", flush=True)
            late_ms.clear()


if __name__ == "__main__":
    config = os.environ.get("ZENOH_CONFIG")
    with suppress(KeyboardInterrupt), zenoh.open(zenoh.Config.from_file(config) if config else zenoh.Config()) as here:
        if sys.argv[1:] == ["in"]:
            receive(here)
        elif sys.argv[1:2] == ["out"]:
            send(here, sys.argv[2] if len(sys.argv) > 2 else default_publish())
        else:
            sys.exit(__doc__)
