"""Exchanges of units: what steps of one unit cannot mend, and that they end."""

import numpy as np
import pytest

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.skin.parts import Map
from eitskin_proto.skin.skin import Skin
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.reduced.exact import ExactSheet, exact_sheet
from eitskin_sim.reduced.model import ReducedModel, reduced, rows_of
from eitskin_sim.reduced.state import state_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import flat_metric_of
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.verification.frame import Frame
from eitskin_sim.verification.prior import Prior
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sets.exchange import Exchange
from eitskin_sim.verification.sets.price import UnitPrice

SMALL = Skin(name="small", map=Map((12, 18), (4, 6)))
"""Few, large units."""

TRUE = [8, 10, 19]
CONTENT = 130.0


@pytest.fixture(scope="module")
def sheet() -> ExactSheet:
    return exact_sheet(bend_metric(Bend(angle_deg=80.0, stretch_along=1.1), Sheet()), SMALL)


@pytest.fixture(scope="module")
def model(sheet: ExactSheet) -> ReducedModel:
    return reduced(sheet, SMALL)


def exchange(sheet: ExactSheet, model: ReducedModel, late: bool = False, content: float = CONTENT) -> Exchange:
    flat = rows_of(exact_sheet(flat_metric_of(SMALL), SMALL).untouched)
    volts = rows_of(sheet.currents(np.array(TRUE), np.full(3, 50.0))[1])
    noisy = add_noise(volts, flat, "N2", 50.0, np.random.default_rng(3))
    frame = Frame(relative_change(noisy, flat), flat, Noise())

    def explains(units: np.ndarray, contrast: float) -> bool:
        state = state_of(model, units, np.full(len(units), contrast))
        return float(frame.chi_squared(state.volts / flat)) < content

    price = UnitPrice(model.shape, Prior(places=24), 50.0)
    return Exchange(model.of_rank(8), flat, frame, price, content, explains, lambda: late)


def test_a_unit_between_two_that_are_touched_becomes_the_two(sheet: ExactSheet, model: ReducedModel) -> None:
    found = exchange(sheet, model).improved([np.array([9, 19])], 50.0)
    assert found.tolist() == TRUE


def test_two_that_are_each_one_place_off_are_put_right(sheet: ExactSheet, model: ReducedModel) -> None:
    found = exchange(sheet, model).improved([np.array([2, 16, 19])], 50.0)
    assert found.tolist() == TRUE


def test_the_search_ends_where_nothing_explains_the_frame(sheet: ExactSheet, model: ReducedModel) -> None:
    own = exchange(sheet, model, content=0.0)
    assert own.improved([np.array([9])], 50.0).tolist() == TRUE
    assert own.evaluations < 200


def test_without_time_the_cheapest_start_is_the_answer(sheet: ExactSheet, model: ReducedModel) -> None:
    own = exchange(sheet, model, late=True)
    assert own.improved([np.array([9]), np.array([8, 10]), np.array([0])], 50.0).tolist() == [8, 10]


def test_a_model_of_fewer_patterns_is_nearly_the_model(sheet: ExactSheet, model: ReducedModel) -> None:
    coarse, units = model.of_rank(8), np.array(TRUE)
    whole, part = (state_of(one, units, np.full(3, 50.0)).volts for one in (model, coarse))
    off = np.sqrt(np.mean(np.log(part / whole) ** 2))
    assert 0.0 < off < 0.02
    assert coarse.nbytes < model.nbytes / 3
    with pytest.raises(ValueError, match="expected from 1 to 16"):
        model.of_rank(17)


def test_two_candidates_beside_a_set_are_the_set_with_both(model: ReducedModel) -> None:
    state = state_of(model, np.array([8, 19]), np.array([50.0, 0.4]))
    places = np.array([0, 3, 9, 22])
    found = state.beside(places, 20.0).two(np.array([0, 1]), np.array([2, 3]))
    for row, pair in zip(found, ([0, 9], [3, 22]), strict=True):
        whole = state_of(model, np.array([8, 19, *pair]), np.array([50.0, 0.4, 20.0, 20.0]))
        assert row == pytest.approx(whole.volts, rel=1e-9)
