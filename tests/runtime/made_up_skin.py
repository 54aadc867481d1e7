"""Virtual skins with made-up voltages, each a process; one process makes them all, so that each is there at once."""

import json
import os
import select
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path


def begin_touches(port):
    """Let the touches of a virtual skin with ``touches_wait`` begin."""
    (Path(port).parent / "begin").touch()


@cache
def _maker():
    """Start, once, the process that makes virtual skins: it ends with this one."""
    return subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("skin_process.py"))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


@contextmanager
def virtual_skin(**options):
    """Run a virtual skin with options of ``skin_process.py``, and give its port."""
    maker = _maker()
    maker.stdin.write(json.dumps(options) + "\n")
    maker.stdin.flush()
    port, number = maker.stdout.readline().split()
    process = os.pidfd_open(int(number))
    try:
        yield port
    finally:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(process, signal.SIGTERM)  # it then takes its port's folder along
        if not select.select([process], [], [], 30)[0]:
            signal.pidfd_send_signal(process, signal.SIGUSR1)  # its stack goes to stderr
            select.select([process], [], [], 1)
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(process, signal.SIGKILL)
            shutil.rmtree(Path(port).parent, ignore_errors=True)  # it could not
        os.close(process)
