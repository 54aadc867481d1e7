"""Recordings of November 2026, made before the runtime computed whole maps only: they reinfer bit by bit.

Each is of simulated touches, with a shipped bundle ::

    health      drift that is followed, electrode 5 lost, 9 excluded by hand, a cloud given and taken back
    unchanged   maps that are kept while only noise changes, across a cloud
    press       touches that lower conductance, and one too faint to be seen
    budget      every solver of the bundle in turn
    idle        frames of a few drives between whole scans
    regions     every solver in turn, for one rectangle and then for two; with the maps that were published
"""

from pathlib import Path

import numpy as np
import pytest

from eitskin_tools.recording.codec import unpack_map
from eitskin_tools.recording.layout import MAP
from eitskin_tools.recording.reinfer import reinfer
from eitskin_tools.recording.script import Script, bundle_of

FOLDER = Path(__file__).parents[2] / "golden" / "recordings"
FRAMES = {"health": 114, "unchanged": 55, "press": 60, "budget": 38, "idle": 44}


@pytest.fixture(scope="module")
def same_rounding() -> None:
    """Skip where this processor rounds maps otherwise than the one that recorded: their digests are of every bit."""
    script = Script(FOLDER / "regions.mcap")
    if reinfer(script, bundle_of(script)).fields()["equal"] < 30:
        pytest.skip("this processor rounds maps otherwise than the one that recorded; tools/contract.sh records here")


@pytest.mark.usefixtures("same_rounding")
@pytest.mark.parametrize("name", FRAMES)
def test_a_recording_of_an_earlier_release_reinfers_bit_by_bit(name: str) -> None:
    script = Script(FOLDER / f"{name}.mcap")
    found = reinfer(script, bundle_of(script)).fields()
    assert found["equal"] == found["published"] == FRAMES[name]


@pytest.mark.usefixtures("same_rounding")
def test_a_recording_of_parts_of_maps_is_read_as_whole_maps_that_are_cut_to_them() -> None:
    script = Script(FOLDER / "regions.mcap")
    found = reinfer(script, bundle_of(script), keep=100)
    fields = found.fields()
    assert fields["equal"] + fields["unknown_why"].get("region", 0) == fields["published"] == 34
    assert fields["differing"] == {}
    published = dict(unpack_map(entry.data) for entry in script.recording.entries({MAP.topic}))
    computed = {step.frame.seq: one.map for step, one in found.kept if one.map.any()}
    assert len(computed) == 20
    for seq, values in computed.items():
        np.testing.assert_allclose(values, published[seq], atol=1e-6)
    assert sum(values[25, 2] == 0.0 for values in computed.values()) >= 16
