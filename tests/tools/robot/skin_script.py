"""A stand-in for ``eitskin run`` of one skin: what it does is its port's name. Starts in milliseconds with ``-S``."""

import json
import os
import signal
import sys
from pathlib import Path

words = dict(word[2:].split("=", 1) for word in sys.argv[2:] if "=" in word)
kind, _, folder = words["port"].partition("@")


def say(event, **fields):
    print(json.dumps({"event": event, **fields}), file=sys.stderr, flush=True)


def serve():
    say("ready", publish=words["publish"], control=words["control"])
    while True:
        signal.pause()


signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
if kind in ("good", "other"):
    serve()
elif kind == "fails":
    say("error", text="no port /dev/ttyNONE")
    sys.exit(1)
elif kind == "usage":
    print("eitskin run: --baud is 5", file=sys.stderr)
    sys.exit(2)
elif kind == "once":  # falls the first time, and is well after that
    mark = Path(folder) / "fell"
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    serve()
elif kind == "deaf":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    serve()
elif kind == "babbles":
    os.write(2, b"\xff\xfe no json\n" + b"x" * 300_000 + b"\n[1]\n{\n")
    serve()
elif kind == "environment":
    say(
        "info",
        text=" ".join(name for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC", "JOURNAL_STREAM") if name in os.environ),
    )
    serve()
