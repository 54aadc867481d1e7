"""How tests run a command: within this process, and a few as a user does, in a process of its own."""

import gc
import io
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout


def command(*words, **options):
    """Start a command as a process."""
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-m", "eitskin_tools.cli", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def finished(*words):
    """Run a command to its end within this process; return its exit status and what it wrote."""
    from eitskin_tools.cli import main

    out, err = io.StringIO(), io.StringIO()
    interval_s = sys.getswitchinterval()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            status = main([str(word) for word in words])
        finally:  # what a frame loop asks of its process
            sys.setswitchinterval(interval_s)
            gc.unfreeze()
    return status, out.getvalue(), err.getvalue()


def wait_until_ready(process):
    seen = []
    for line in process.stderr:
        seen.append(line)
        if line.startswith("ready "):
            return "".join(seen)
    raise AssertionError("".join(seen))
