"""``eitskin run --verify`` as a user starts it: the verifier's process comes and goes with the runtime, however."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import eitskin

from .conftest import PATIENCE_S, TESTS, TOUCHED, until, virtual_skin

pytestmark = pytest.mark.process


def is_gone(pid):
    """Whether a process has ended; one that nobody has waited for yet has."""
    try:
        return "\nState:\tZ" in Path(f"/proc/{pid}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return True


@pytest.mark.parametrize(("number", "stopped"), [
    (signal.SIGTERM, False), (signal.SIGKILL, True),
])  # fmt: skip
def test_the_verifier_ends_with_the_runtime_however_that_ends(tmp_path, number, stopped):
    control = f"ipc://{tmp_path}/control"
    words = [sys.executable, "-m", "eitskin_tools.cli", "run", "--bundle", TESTS / "golden" / "tiny.eitskin"]
    words += ["--publish", f"ipc://{tmp_path}/frames", "--control", control, "--reference-frames", "10"]
    words += ["--verify", "idle", "--verify-nice", "7", "--verify-budget-ms", "30"]
    with (
        virtual_skin(touches=TOUCHED, rate_hz=50.0) as port,
        subprocess.Popen([*words, "--port", port], stderr=subprocess.PIPE, text=True) as runtime,
    ):
        try:
            assert runtime.stderr is not None
            assert any(line.startswith("ready ") for line in runtime.stderr)
            status = {}

            def runs():
                status.update(eitskin.request(control, "status", timeout_s=PATIENCE_S)["verifier"])
                return bool(status.get("pid"))  # "ready" is said a moment before it starts

            until(runs)
            assert (status["mode"], status["nice"], status["restarts"]) == ("idle", 7, 0)
            pid = int(status["pid"])
            until(lambda: os.getpriority(os.PRIO_PROCESS, pid) == status["nice"])  # it takes it once it is tied to us
            if stopped:
                os.kill(pid, signal.SIGSTOP)
            runtime.send_signal(number)
            assert runtime.wait(PATIENCE_S) == (0 if number == signal.SIGTERM else -number)
            until(lambda: is_gone(pid))
        finally:
            runtime.kill()  # or leaving would wait for it
