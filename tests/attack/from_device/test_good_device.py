"""Left alone, the device of SPEC.md is a good one: every command works with it, and no frame is lost."""

import json
import subprocess
import sys
from typing import Any

import pytest

from ..stream import ROOT, TINY
from .trial import device, trial

pytestmark = pytest.mark.process


def told(*command: str) -> Any:
    done = subprocess.run(
        [sys.executable, "-m", "eitskin_tools.cli", *command, "--json"],
        check=False,
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_doctor_and_flash_read_it_and_write_it() -> None:
    with device() as skin:
        port = ("--port", skin.port)
        assert told("doctor", *port)["device"]["serial_number"] == "OWN-0001"
        assert told("flash", "show", *port)["active"]["name"] == "own"
        assert told("flash", "write", "full208", *port)["generation"] == 2
        assert told("flash", "verify", "full208", *port)["same"]
        assert told("doctor", *port)["device"]["rows"] == 208
        assert told("flash", "rollback", *port)["configuration"] == "own"


@pytest.mark.parametrize("options", [{"sample_bytes": 2}, {"rows": 208, "rate_mHz": 100_000}, {"sample_bytes": 4}])
def test_run_reads_every_frame_of_every_size(options: dict[str, int], tmp_path: Any) -> None:
    with device(**options) as skin:
        where = ("--publish", f"ipc://{tmp_path}/f", "--control", f"ipc://{tmp_path}/c", "--bundle", str(TINY))
        found = told("run", "--port", skin.port, *where, "--reference-frames", "20", "--frames", "200", "--quiet")
        said = skin.order(do="report")
    assert (found["frames"], found["lost"], found["corrupt"], found["resets"]) == (200, 0, 0, 0)
    assert said["damaged_requests"] == 0


def test_what_is_published_is_what_was_sent_to_the_last_frame() -> None:
    with trial() as running:
        at = running.device.order(do="report")["next"]
        assert running.recovered(running.device.order(do="nothing", frames=200)) is not None
        numbers = [frame.sequence for frame in running.witness.frames if frame.sequence >= at]
        assert numbers == list(range(at, at + len(numbers)))
        assert len(numbers) >= 200
        assert not running.wrong(running.witness.frames)
        assert not running.witness.broken
        assert running.witness.lost == running.witness.frames[-1].counts["lost"] == 0


def test_a_changed_content_would_be_seen() -> None:
    with trial() as running:
        at = len(running.witness.frames)
        assert running.recovered(running.device.order(do="rows", kind="turned", frames=20)) is not None
        assert len(running.wrong(running.witness.frames[at:])) == 20
