"""Flips of units out of a pool: against sets that are made anew, from any set, of either sign, and back again."""

import numpy as np
import pytest

from eitskin_proto.skin.parts import Map
from eitskin_proto.skin.skin import Skin
from eitskin_sim.reduced.exact import exact_sheet
from eitskin_sim.reduced.flips import FRESH, Flips
from eitskin_sim.reduced.making import reduced
from eitskin_sim.reduced.model import ReducedModel
from eitskin_sim.reduced.state import state_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Sheet

SMALL = Skin(name="small", map=Map((12, 18), (4, 6)))
POOL = np.array([0, 3, 8, 9, 10, 17, 22])
CONTRASTS = np.array([50.0, 0.4, 50.0, 3.0, 0.1, 50.0, 200.0])


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    return reduced(exact_sheet(bend_metric(Bend(angle_deg=80.0, stretch_along=1.1), Sheet()), SMALL), SMALL)


@pytest.fixture
def flips(model: ReducedModel) -> Flips:
    found = Flips(model, POOL, CONTRASTS)
    found.to(np.array([False, True, True, False, True, False, False]))
    return found


def anew(model: ReducedModel, inside: np.ndarray) -> np.ndarray:
    return state_of(model, POOL[inside], CONTRASTS[inside]).volts


def test_a_set_reads_as_if_it_were_made_anew(model: ReducedModel, flips: Flips) -> None:
    assert flips.volts == pytest.approx(anew(model, flips.inside), rel=1e-9)


def test_each_flip_puts_a_unit_in_or_takes_it_out(model: ReducedModel, flips: Flips) -> None:
    for number, row in enumerate(flips.each()):
        inside = flips.inside.copy()
        inside[number] ^= True
        assert row == pytest.approx(anew(model, inside), rel=1e-9)


def test_two_flips_at_once_are_both(model: ReducedModel, flips: Flips) -> None:
    first, second = np.triu_indices(len(POOL), 1)
    for one, two, row in zip(first, second, flips.pairs(first, second), strict=True):
        inside = flips.inside.copy()
        inside[[one, two]] ^= True
        assert row == pytest.approx(anew(model, inside), rel=1e-8)


def test_many_flips_lose_nothing(model: ReducedModel, flips: Flips) -> None:
    start, rng = flips.inside.copy(), np.random.default_rng(1)
    for _ in range(FRESH // 2):
        flips.to(rng.random(len(POOL)) < 0.5)
    flips.to(start)
    assert flips.volts == pytest.approx(anew(model, start), rel=1e-7)
