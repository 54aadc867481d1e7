"""Which threads of a runtime compute."""

import signal
import time
from pathlib import Path

import pytest

import eitskin

from .command_line import command, wait_until_ready
from .made_up_skin import begin_touches

pytestmark = pytest.mark.process

ENOUGH = 8
"""Clock ticks of the thread that computes, 80 ms of work: the measurement sees what runs."""


def ticks(pid):
    """Return {thread: (name, clock ticks)} of a process."""
    found = {}
    for thread in Path(f"/proc/{pid}/task").iterdir():
        fields = (thread / "stat").read_text().rpartition(")")[2].split()
        found[int(thread.name)] = ((thread / "comm").read_text().strip(), int(fields[11]) + int(fields[12]))
    return found


def test_one_thread_computes_and_no_other_runs(virtual_skin, tiny_path, tmp_path, endpoints):
    with virtual_skin(touches=[[0.15, 60, 0.3]], touches_wait=True, rate_hz=200.0) as port:
        words = ["--bundle", tiny_path, "--reference-frames", 10, *endpoints]
        process = command("run", "--port", port, *words)
        wait_until_ready(process)
        begin_touches(port)
        with eitskin.subscribe(f"ipc://{tmp_path}/frames", timeout_s=60) as frames:
            before = after = ticks(process.pid)
            end = time.perf_counter() + 120
            while after[process.pid][1] < before[process.pid][1] + ENOUGH and time.perf_counter() < end:
                next(frames)
                after = ticks(process.pid)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=120)
    used = {thread: after[thread][1] - before.get(thread, ("", 0))[1] for thread in after}
    main = used.pop(process.pid)
    others = {thread: spent for thread, spent in used.items() if not after[thread][0].startswith("ZMQbg")}
    assert main >= ENOUGH
    assert sum(others.values()) <= 1, (main, others, after)
