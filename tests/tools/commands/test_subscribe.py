"""``eitskin subscribe --verified``: forces by a user's table, and what is said once."""

import threading
import time
from contextlib import contextmanager

from eitskin.messaging.publish import Publisher
from eitskin.messaging.streams.verified import VerifiedTouch, pack_head, pack_verdict
from eitskin_tools import cli

TOUCH = VerifiedTouch(
    shape="rectangle", unit=None, centre_mm=(40.0, 30.0), centre_error_mm=(0.1, 0.2), size_mm=(12.0, 10.0),
    size_error_mm=(0.3, 0.4), angle_rad=0.5, area_mm2=120.0, area_error_mm2=4.0, contrast=50.0, strength_mm2=50.0,
    strength_error_mm2=20.0, border_mm=0.0, place_mm=(40.0, 30.0, 5.0), normal=(0.0, 0.0, 1.0),
)  # fmt: skip
COUNTS = {"checked": 0, "flagged": 0, "skipped": 0}
READY = pack_verdict(1, 0, 0, "ready", "", (1, 2, 0, 0))
FLAGGED = pack_verdict(1, 0, 0, "ready", "time", (1, 2, 3, 4), (130.0, 104, 0.046, True), (TOUCH,))
EXPLAINED = pack_verdict(1, 0, 0, "ready", "", (1, 2, 3, 4), (101.0, 104, 0.5, False), (TOUCH,))


@contextmanager
def published(endpoint, *messages):
    """Publish what a verifier says, once somebody asks."""
    left = threading.Event()

    def publish():
        publisher = Publisher(endpoint)
        while not publisher.verified and not left.is_set():
            publisher.update()
            time.sleep(0.01)
        for number, message in enumerate(messages, 1):
            publisher.send_beside(pack_head(number, "run", COUNTS) + message)
        left.wait()
        publisher.close()

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        left.set()
        thread.join()


def test_verified_touches_have_forces_and_nothing_is_said_twice(tmp_path, capsys):
    table, endpoint = tmp_path / "force.csv", f"ipc://{tmp_path}/frames"
    table.write_text("strength,newtons,newtons_error\n0,0,0\n100,2,0\n")
    words = ["subscribe", endpoint, "--verified", "--mode", "all", "--frames", "2", "--timeout-s", "60"]
    with published(endpoint, READY, FLAGGED, READY, EXPLAINED):
        assert cli.main([*words, "--force-table", str(table)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "1 not verified: the verifier is ready, with no new verdict"
    assert "FLAGGED: no confirmed explanation within the time limit, p 0.046" in lines[1]
    assert lines[2].endswith("strength 50 +- 20 mm2, force 1.00 +- 0.40 N")
    assert "verified" in lines[3]
    assert len(lines) == 5
