"""What is printed of verdicts: why a frame is flagged, how the verifier is, and forces by a table of one's own."""

import dataclasses

import pytest

from eitskin.messaging.streams.verified import FLAGS, VerifiedFrame, VerifiedTouch
from eitskin_tools.console.stream_view import FLAGGED, describe_verdict

TOUCH = VerifiedTouch(
    shape="rectangle", unit=None, centre_mm=(40.0, 30.0), centre_error_mm=(0.1, 0.2), size_mm=(12.0, 10.0),
    size_error_mm=(0.3, 0.4), angle_rad=0.5, area_mm2=120.0, area_error_mm2=4.0, contrast=50.0, strength_mm2=50.0,
    strength_error_mm2=20.0, border_mm=0.0, place_mm=(40.0, 30.0, 5.0), normal=(0.0, 0.0, 1.0),
)  # fmt: skip
STAMPS = {"read": 1, "publish": 2, "begin": 3, "end": 4}
FOUND = VerifiedFrame(
    7, "ready", "", (TOUCH,), 104.5, 104, 0.046, True, 0, {"checked": 5, "flagged": 1, "skipped": 2}, STAMPS, 1, 1, "r"
)


def test_each_reason_for_a_flag_is_said():
    said = {why: describe_verdict(dataclasses.replace(FOUND, why=why))[0] for why in (*FLAGS, "")}
    assert all(f"7 {FLAGGED[why]}, p 0.046, " in said[why] for why in FLAGS)
    assert "7 FLAGGED, p 0.046" in said[""]
    assert "7 explained, " in describe_verdict(dataclasses.replace(FOUND, flagged=False))[0]


@pytest.mark.parametrize("why", ["", "it is late"])
def test_a_verifier_that_is_ready_does_not_say_that_nothing_has_changed(why):
    found = dataclasses.replace(FOUND, p_value=None, touches=None, flagged=None, why=why)
    assert describe_verdict(found) == [
        f"7 not verified: the verifier is ready, with no new verdict{why and f': {why}'}",
    ]
