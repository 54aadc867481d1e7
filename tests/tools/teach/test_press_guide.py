"""Presses that a person is led through, or that a recording holds; no clock anywhere."""

import re

import numpy as np
import pytest

from eitskin_tools.guided import GuideError
from eitskin_tools.teach.guide import PressGuide, PressRecorder, places_of
from eitskin_tools.teach.places import Place, grid_places

ROWS = np.arange(60)
UNTOUCHED = 1e-3 * 10.0 ** (-ROWS / 60.0)
FACTS = {"size_mm": np.array([100.0, 60.0]), "outline": np.array("rectangle")}
PLACES = [Place("A1", 20.0, 30.0), Place("B1", 50.0, 10.0), Place("C1", 80.0, 45.0)]
NOISE = 1e-3


def response(place):
    return 0.004 * np.cos(ROWS * (1.0 + place.x_mm / 50.0))


class Finger:
    """Presses where it is told, lets go, and leaves a tenth of each press behind; drifts all the while."""

    def __init__(self, answers=()):
        self.told, self.answers, self.ended = [], list(answers), False
        self.push = np.zeros(60)
        self.rng = np.random.default_rng(3)

    def say(self, text):
        self.told.append(text)
        if found := re.search(r"press (\w\d) ", text):
            self.push = response(next(one for one in PLACES if one.name == found[1]))
        elif "Let go" in text:
            self.push = 0.1 * self.push

    def show(self, text):
        pass

    def answer(self):
        if self.answers and re.search(self.answers[0][0], self.told[-1]):
            self.push = np.zeros(60)  # a person who types presses nothing
            return self.answers.pop(0)[1]
        return None

    def frames(self, most=20_000):
        for number in range(most):
            drift = 1e-6 * number * (1.0 + 0.3 * np.sin(ROWS))
            yield UNTOUCHED * np.exp(self.push + drift + NOISE * self.rng.standard_normal(60))


def guided(path, finger, places=PLACES, most=20_000):
    recorder = PressRecorder(path, places, FACTS)
    PressGuide(recorder, finger.frames(most), finger).run()
    return np.load(path)


def test_each_press_is_felt_and_kept_beside_the_untouched_reading_before_it(tmp_path):
    found = guided(tmp_path / "p.npz", Finger())
    assert found["xy_mm"][1::2].tolist() == [[one.x_mm, one.y_mm] for one in PLACES]
    assert np.isnan(found["xy_mm"][::2]).all()
    change = np.log(found["voltages_V"][1::2] / found["voltages_V"][::2])
    left_behind = [0.0, *(0.1 * response(one) for one in PLACES[:-1])]
    for one, place, before in zip(change, PLACES, left_behind, strict=True):
        assert np.abs(one - (response(place) - before)).max() < 6.0 * NOISE * np.sqrt(2 / 40)
    assert found["outline"] == "rectangle"


def test_going_back_repeats_a_press_and_skipping_leaves_it_out(tmp_path):
    finger = Finger([("2 of 3: press", "b"), ("3 of 3: press", "s")])
    found = guided(tmp_path / "p.npz", finger)
    assert sum("1 of 3: press" in one for one in finger.told) == 2
    assert found["xy_mm"][1::2].tolist() == [[20.0, 30.0], [50.0, 10.0]]


def test_what_was_pressed_before_it_ended_is_kept_and_not_asked_for_again(tmp_path):
    path = tmp_path / "p.npz"
    with pytest.raises(GuideError, match="stopped on request; the presses so far are kept"):
        guided(path, Finger([("2 of 3: press", "q")]))
    with pytest.raises(GuideError, match="no more frames; the presses so far are kept"):
        guided(path, Finger(), most=30)
    finger = Finger()
    found = guided(path, finger)
    assert finger.told[0].startswith("2 presses to go")
    assert found["xy_mm"][1::2].tolist() == [[one.x_mm, one.y_mm] for one in PLACES]
    with pytest.raises(GuideError, match=r"a press at \(20, 30\) mm, expected one of this command's 1 places"):
        PressRecorder(path, PLACES[1:2], FACTS)


@pytest.mark.parametrize(
    ("size_mm", "outline", "count"), [((150.0, 100.0), "rectangle", 60), ((170.0,) * 2, "disc", 60)]
)
def test_places_are_spread_over_the_sheet_and_inside_it(size_mm, outline, count):
    places = grid_places(size_mm, outline, count)
    assert len({one.name for one in places}) == len(places)
    assert 0.8 * count <= len(places) <= 1.2 * count
    xy = np.array([(one.x_mm, one.y_mm) for one in places])
    assert np.abs(xy.mean(axis=0) - np.array(size_mm) / 2).max() < 1.0
    if outline == "disc":
        assert np.hypot(*(xy - 85.0).T).max() < 85.0


def test_places_are_read_from_a_text_file(tmp_path):
    path = tmp_path / "places.csv"
    path.write_text("x_mm,y_mm\n10, 20.5\n\n# later\n30;40\n")
    assert [(one.x_mm, one.y_mm) for one in places_of(path)] == [(10.0, 20.5), (30.0, 40.0)]
    path.write_text("10, 20\n10, far\n")
    with pytest.raises(GuideError, match=r"places.csv:2: found '10, far', expected x and y in mm"):
        places_of(path)
