"""How tests start a command as a user does, and wait for it."""

import subprocess
import sys


def command(*words, **options):
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-m", "eitskin_tools.cli", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def finished(*words):
    process = command(*words)
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err


def wait_until_ready(process):
    seen = []
    for line in process.stderr:
        seen.append(line)
        if line.startswith("ready "):
            return "".join(seen)
    raise AssertionError("".join(seen))
