"""An honest subscriber, as a process: counts what it got and what it missed, and says so when it is ended.

    python -m tests.attack.honest ENDPOINT PROCESS [SERVER.key CLIENT.key_secret]

Prints ``subscribed`` with the first frame; at SIGTERM one JSON object: frames, lost (gaps in the numbers of published
frames), the longest silence in seconds, and for the stream's pace ``passed``, of every frame its number, its sequence
number, device clock in us and when it was published in ns, and for how long ``waited_ns`` the runtime, whose process
is named, was without a core meanwhile.
"""

import json
import signal
import sys
import time
from contextlib import suppress
from typing import Any

import eitskin

from .pace import Waits


def main() -> None:
    """Subscribe until told to stop."""
    stopping = False

    def stop(*_: Any) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    heard_s = silent_s = 0.0
    keys = eitskin.load_client_keys(*sys.argv[3:5]) if sys.argv[3:] else None
    waits, passed = Waits(int(sys.argv[2])), []
    with eitskin.subscribe(sys.argv[1], "all", timeout_s=0.2, keys=keys) as frames:
        while not stopping:
            with suppress(eitskin.NoFrame):
                frame = frames.next_frame()
                now_s = time.monotonic()
                waits.look(int(now_s * 1e9))
                passed.append((frame.number, frame.sequence, frame.device_us, frame.host_ns["publish"]))
                if frames.received == 1:
                    print("subscribed", flush=True)
                else:
                    silent_s = max(silent_s, now_s - heard_s)
                heard_s = now_s
        if frames.received:
            silent_s = max(silent_s, time.monotonic() - heard_s)
        found = {"frames": frames.received, "lost": frames.lost, "longest_silence_s": round(silent_s, 3)}
    print(json.dumps(found | {"waited_ns": waits.total_ns, "passed": passed}), flush=True)


if __name__ == "__main__":
    main()
