"""Workers that make shards end with the process that started them, however that ends."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from eitskin_proto.errors import SkinError
from eitskin_sim.dataset import generate

pytestmark = pytest.mark.process

ENDLESS = Path(__file__).parent / "endless_process.py"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nobody_computes_on(number: signal.Signals) -> None:
    with subprocess.Popen([sys.executable, str(ENDLESS)], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert [process.stdout.readline() for _ in range(2)] == [b"begun\n"] * 2
        process.send_signal(number)
        rest, _ = process.communicate(timeout=120)  # whose end comes when the last of them has let go of it
    assert rest == b""
    assert process.returncode != 0


class _Fatal:
    """Ends the process that unpickles it, as the kernel does where memory is short."""

    def __reduce__(self) -> tuple[object, ...]:
        return os._exit, (9,)


def test_a_worker_that_is_ended_from_outside_is_told_of_in_one_line() -> None:
    with pytest.raises(SkinError, match=r"a worker process was killed.*the same command resumes"):
        list(generate._in_processes([{"deformations": [0], "fatal": _Fatal()}], 1))
