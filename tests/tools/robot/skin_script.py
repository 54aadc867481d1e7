"""A stand-in for ``eitskin run`` of one skin: what it does is its port's name. Starts in milliseconds with ``-S``."""

import faulthandler
import json
import os
import signal
import sys
from pathlib import Path

words = dict(word[2:].split("=", 1) for word in sys.argv[2:] if "=" in word)
kind, _, folder = words["port"].partition("@")


def say(event, **fields):
    print(json.dumps({"event": event, **fields}), file=sys.stderr, flush=True)


def serve(until=None):
    """Give signs of life, for ever or until there is a file."""
    say("ready", publish=words["publish"], control=words["control"])
    while until is None or not until.exists():
        signal.sigtimedwait([], 0.1)
        faulthandler.dump_traceback_later(float(os.environ["EITSKIN_HANG_S"]), exit=True)


def hang():
    """Keep the interpreter for ever, in C code: neither a signal's handler nor any other thread runs again."""
    import ctypes

    mutex = ctypes.create_string_buffer(64)  # one that is locked twice
    lock = ctypes.PyDLL(None).pthread_mutex_lock
    while lock(mutex) == 0:
        pass


def first_time():
    mark = Path(folder) / "fell"
    found = not mark.exists()
    mark.touch()
    return found


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
    if first_time():
        os.kill(os.getpid(), signal.SIGKILL)
    serve()
elif kind == "hangs":  # once it is told to, the first time
    if first_time():
        serve(Path(folder) / "hang")
        hang()
    serve()
elif kind == "prints":  # faster than anybody reads, and never a whole line
    while True:
        os.write(sys.stderr.fileno(), bytes(1 << 16))
elif kind == "starts":  # for ever
    while True:
        signal.pause()
elif kind == "deaf":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    serve()
elif kind == "environment":
    say("info", text=" ".join(os.environ.get(name, "none") for name in ("NOTIFY_SOCKET", "JOURNAL_STREAM")))
    serve()
