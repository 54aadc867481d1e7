"""A hydrogel that is read without ``--touches lower`` says so within seconds, and a known touch says nothing."""

import numpy as np
import pytest

import eitskin
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import DISC, RECTANGLE, gather
from eitskin_tools.console.words import event_words


@pytest.fixture(scope="module")
def sheet():
    return inverted_sheet(Bend())


SMALL = (RECTANGLE, 56.0, 46.0, 12.0, 12.0)
LARGE = (DISC, 60.0, 45.0, 24.0, 24.0)


@pytest.mark.parametrize(
    ("touches", "shape", "contrast", "doubt"),
    [
        ("raise", LARGE, 0.4, "lower"),
        ("lower", LARGE, 3.0, "raise"),
        ("raise", LARGE, 3.0, ""),
        ("raise", SMALL, 50.0, ""),
        ("lower", LARGE, 0.4, ""),
    ],
)
def test_touches_of_the_other_kind_are_an_event_that_names_the_remedy(sheet, touches, shape, contrast, doubt):
    pressed = set_voltages([sheet], gather([np.array([[*shape, 0.0, contrast, 0.0]])]))[0, 0]
    rng, flat = np.random.default_rng(0), 1e-3 * sheet.untouched_V

    def noisy(volts, count):
        return volts * (1.0 + 0.002 * rng.standard_normal((count, 104)))

    found, statuses = {}, []
    feed = eitskin.Feed("adjacent-104", rate_hz=20.0)
    with eitskin.Skin(source=feed, touches=touches, reference=noisy(flat, 100)) as skin:
        for number, volts in enumerate(noisy(1e-3 * pressed, 100)):
            frame = skin.feed(volts, 50_000 * number)
            found.update(dict.fromkeys(frame.events, number))
            statuses.append(skin.status()["touch_doubt"])
    named = {event: number for event, number in found.items() if event.startswith("touches:")}
    assert list(named) == ([f"touches:{doubt}"] if doubt else [])
    assert statuses[-1] == doubt
    for event, number in named.items():
        assert 50 <= number <= 75  # after three seconds, at 20 frames/s
        assert f"--touches {doubt}" in event_words(event)
