"""``eitskin doctor --recorded FILE.mcap``: the last seconds, by the reference that held then."""

import argparse
import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

from eitskin import Conditions, SkinState, WireFrame
from eitskin.model.bundle import load_bundle
from eitskin.reference.captured import stored
from eitskin_tools.commands import doctor
from eitskin_tools.recording.script import Script

from ..conftest import TINY, recorded, reference

FROM = 60
"""Frames that the first reference holds for."""


def test_a_reference_that_was_captured_anew_is_the_one_of_the_frames_behind(tmp_path: Path, items: list[Any]) -> None:
    first = reference()
    second = replace(first, voltages_V=1.02 * first.voltages_V)
    content = stored(second)
    digest = hashlib.sha256(content).hexdigest()
    state = next(one for one in items if isinstance(one, SkinState))
    before = [one for one in items if isinstance(one, Conditions)][-1]
    anew = replace(before, revision=1000, reference=digest)
    stream: list[Any] = []
    frames = 0
    for item in items:
        if isinstance(item, WireFrame):
            frames += 1
            if frames == FROM:
                stream += [replace(state, n=1000, reference=content, reference_sha256=digest), anew]
            stream.append(replace(item, conditions=1000) if frames >= FROM else item)
        elif isinstance(item, SkinState) and frames >= FROM:
            stream.append(replace(item, reference=None, reference_sha256=digest))
        elif not isinstance(item, Conditions) or frames < FROM:
            stream.append(item)
    recorded(tmp_path / "a.mcap", stream)
    for seconds in (0.3 * Script(tmp_path / "a.mcap").seconds, 1000.0):
        words = argparse.Namespace(recorded=tmp_path / "a.mcap", seconds=seconds)
        looked_at, held = doctor._of_recording(words, load_bundle(TINY))
        assert 0 < len(looked_at.voltages) <= 150
        assert held.voltages_V.tolist() == second.voltages_V.tolist()
