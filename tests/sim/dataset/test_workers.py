"""Workers that make shards end with the process that started them, however that ends."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

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
