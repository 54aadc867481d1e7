"""A guided recording, with a sheet that does what it is asked, or does not: no clock anywhere."""

import re

import numpy as np
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_tools.guided import CalibrationGuide, GuideError, Plan

ROWS = np.arange(104)
FLAT = 1e-3 * 40.0 ** (-ROWS / 103.0)
BENT = FLAT * (1.0 + 0.2 * np.cos(ROWS))
NOISE = 0.003


def pressed(number):
    return FLAT * (1.0 + 0.02 * np.cos(ROWS * (number + 2.0)))


class Sheet:
    """A sheet that follows what was said, and a person who answers; ``moods`` are asked first."""

    def __init__(self, answers=(), drift=0.0):
        self.told, self.shown, self.answers = [], [], list(answers)
        self.ended = False
        self.state, self.before, self.since, self.drift = FLAT, FLAT, 0, drift
        self.rng = np.random.default_rng(1)

    def say(self, text):
        self.told.append(text)
        before = self.state
        if found := re.search(r"press the .* at \((\d+), (\d+)\)", text):
            self.state = pressed(int(found[1]) % 7)
        elif "bend the sheet" in text:
            self.state = BENT
        elif "flat" in text or "free" in text or "Let go" in text:
            self.state = FLAT
        if self.state is not before:
            self.before, self.since = before, 0

    def show(self, text):
        self.shown.append(text)

    def answer(self):
        if self.answers and re.search(self.answers[0][0], self.told[-1]):
            return self.answers.pop(0)[1]
        return None

    def frames(self, most=20_000):
        for _ in range(most):
            self.since += 1
            share = min(self.since / 15.0, 1.0)  # it takes 15 frames to get there
            volts = (1.0 - share) * self.before + share * self.state
            yield volts * (1.0 + self.drift) * (1.0 + NOISE * self.rng.standard_normal(104))
            if self.drift:
                self.drift += 1e-6


PLAN = Plan(places_mm=((40.0, 30.0), (75.0, 50.0)), stamp_mm=(16.0,), bends=1)
SCAN = ("Name the scan", "bent.npz")


def guided(sheet, plan=PLAN, load=lambda name: flat_cloud()):
    return CalibrationGuide(plan, sheet.frames(), sheet, load).run()


def test_every_step_is_recorded_once_the_sheet_shows_it():
    sheet = Sheet([SCAN])
    found = guided(sheet)
    within = 5.0 * NOISE / np.sqrt(40)
    assert np.abs(found["reference_V"] / FLAT - 1.0).max() < within
    assert np.abs(found["bent_V"][0] / BENT - 1.0).max() < within
    assert np.abs(found["press_V"][0] / pressed(40 % 7) - 1.0).max() < within
    assert np.abs(found["press_V"][1] / pressed(75 % 7) - 1.0).max() < within
    assert found["press_xy_mm"].tolist() == [[40.0, 30.0], [75.0, 50.0]]
    assert found["bent_cloud_mm"].shape == (1, 3, 30, 45)
    assert (int(found["reference_frames"]), int(found["bent_frames"])) == (100, 40)


def test_a_drift_of_all_rows_is_no_press():
    sheet = Sheet([SCAN], drift=1e-6)
    assert len(guided(sheet)["press_V"]) == 2


def test_steps_can_be_skipped_and_gone_back_to():
    sheet = Sheet([("bend the sheet", "s"), (r"at \(75, 50\)", "b"), ("Press 2", "s")])
    found = guided(sheet)
    assert "bent_V" not in found
    assert found["press_xy_mm"].tolist() == [[40.0, 30.0]]
    assert sum("at (40, 30)" in one for one in sheet.told) == 2, "the first press was repeated"


def test_the_reference_cannot_be_skipped_and_a_strange_word_is_answered():
    sheet = Sheet([("Lay the sheet", "s"), ("Lay the sheet", "what"), SCAN])
    assert "reference_V" in guided(sheet)
    assert any("cannot be skipped" in one for one in sheet.told)
    assert any("'what' is not an answer here: s skip, b back, q quit" in one for one in sheet.told)


def test_quitting_or_a_silent_skin_ends_it_in_one_line():
    with pytest.raises(GuideError, match="stopped on request; nothing was written"):
        guided(Sheet([("bend the sheet", "q")]))
    sheet = Sheet()
    with pytest.raises(GuideError, match="the skin sends no more frames"):
        CalibrationGuide(PLAN, sheet.frames(50), sheet, lambda name: flat_cloud()).run()


def test_a_scan_that_cannot_be_read_is_asked_for_again():
    asked = []

    def load(name):
        asked.append(name)
        if len(asked) == 1:
            raise OSError("none.npz: no such file")
        return flat_cloud()

    sheet = Sheet([("Name the scan", "none.npz"), ("name another", "bent.npz")])
    assert len(guided(sheet, load=load)["bent_V"]) == 1
    assert asked == ["none.npz", "bent.npz"]
