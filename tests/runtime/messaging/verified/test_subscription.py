"""What a subscriber to verdicts is told to whom none comes."""

import contextlib
from pathlib import Path

import pytest

import eitskin
from eitskin.messaging.publish import Publisher


def said_to(endpoint: str, *, frames: bool) -> str:
    with (
        eitskin.subscribe_verified(endpoint, frames=frames, timeout_s=0.1) as verdicts,
        pytest.raises(eitskin.NoFrame) as caught,
    ):
        next(verdicts)
    return str(caught.value)


@pytest.mark.parametrize("frames", [True, False])
def test_who_waits_at_a_runtime_that_does_not_verify_is_told_how_to_start_it(tmp_path: Path, frames: bool) -> None:
    with contextlib.closing(Publisher(f"ipc://{tmp_path}/frames")) as publisher:
        text = said_to(publisher.endpoint, frames=frames)
    assert "somebody listens there, but sends no verdict" in text
    assert "'eitskin run --verify always'" in text


def test_where_there_is_no_runtime_nobody_is_sent_to_a_verifier(tmp_path: Path) -> None:
    text = said_to(f"ipc://{tmp_path}/frames", frames=False)
    assert "nobody listens there" in text
    assert "--verify" not in text
