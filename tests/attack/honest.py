"""An honest subscriber, as a process: counts what it got and what it missed, and says so when it is ended.

    python -m tests.attack.honest ENDPOINT [SERVER.key CLIENT.key_secret]

Prints ``subscribed`` with the first frame; at SIGTERM one JSON object: frames, lost (gaps in the numbers of published
frames), and the longest silence in seconds.
"""

import json
import signal
import sys
import time
from contextlib import suppress
from typing import Any

import eitskin


def main() -> None:
    """Subscribe until SIGTERM."""
    stopping = False

    def stop(*_: Any) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    heard_s = silent_s = 0.0
    keys = eitskin.load_client_keys(*sys.argv[2:4]) if sys.argv[2:] else None
    with eitskin.subscribe(sys.argv[1], "all", timeout_s=0.2, keys=keys) as frames:
        while not stopping:
            with suppress(eitskin.NoFrame):
                frames.next_frame()
                now_s = time.monotonic()
                if frames.received == 1:
                    print("subscribed", flush=True)
                else:
                    silent_s = max(silent_s, now_s - heard_s)
                heard_s = now_s
        if frames.received:
            silent_s = max(silent_s, time.monotonic() - heard_s)
        found = {"frames": frames.received, "lost": frames.lost, "longest_silence_s": round(silent_s, 3)}
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
