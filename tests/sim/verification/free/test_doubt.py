"""Where the network contradicts what explains a frame, physics is believed only where the network's costs much more."""

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.verification.free import doubt
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Fit
from eitskin_sim.verification.free.found import map_of
from eitskin_sim.verification.free.search import FreeVerifier
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet.model import Model, flat_model_V, model_of_cloud

Array = npt.NDArray[np.float64]

HARD = np.array([[0, 60.0, 45.0, 12.0, 10.0, 0.0, 50.0, 0.0]])
ELSEWHERE = HARD + np.array([0, 45.0, 25.0, 0, 0, 0, 0, 0])
SPECK = HARD * np.array([1, 1, 1, 0.2, 0.2, 1, 1, 1])


@pytest.fixture(scope="module")
def model() -> Model:
    return model_of_cloud(flat_cloud())


def fit_of(model: Model, touches: Array, found: Array, kind: TouchKind = "raising") -> Fit:
    volts = model.touched.solve(touches).voltages_V * (1.0 + 3e-3 * np.random.default_rng(3).standard_normal(104))
    own = FreeVerifier(flat_model_V(PAPER), Noise("N2", 50.0), kind)
    own.deformation.scan(lambda: model)
    return own._frame(volts / flat_model_V(PAPER) - 1.0).at(found)


def shares_of(*touches: Array) -> Array:
    return np.array([map_of(one) for one in touches])


def contested(fit: Fit, every: tuple[tuple[float, Array], ...], shown: Array) -> bool:
    return doubt.contested(fit, every, shown, Effort(100.0))


def test_a_place_that_the_network_alone_shows_is_in_doubt_where_nothing_explains_the_frame(model: Model) -> None:
    right, wrong = (fit_of(model, touches, HARD) for touches in (HARD, ELSEWHERE))
    own = ((1.0, HARD),)
    assert not contested(right, own, shares_of(HARD))
    assert not contested(right, own, shares_of(ELSEWHERE))
    assert contested(wrong, own, shares_of(ELSEWHERE))


def test_what_the_network_shows_of_a_press_is_held_against_the_frame_as_a_press(
    model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Round, with a graded border and of the skin's contrast, as a search starts."""
    press = np.array([[2, 60.0, 45.0, 16.0, 16.0, 0.0, 0.4, 3.0]])
    fit = fit_of(model, press, press, "lowering")
    tried: list[Array] = []

    def kept(_: object, pieces: Array, *__: object) -> Fit:
        tried.append(pieces)
        return fit

    monkeypatch.setattr(doubt, "fitted", kept)
    assert contested(fit, ((1.0, press),), shares_of(press, ELSEWHERE))
    assert tried[0][:, 0].tolist() == [2.0, 2.0]
    assert np.all(tried[0][:, 7] > 0.0)
    assert np.log(tried[0][:, 6]) == pytest.approx(fit.frame.usual.log_contrast)


def test_it_is_in_doubt_where_it_would_explain_the_frame_nearly_as_well(
    model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = fit_of(model, HARD, HARD)
    own, both = ((1.0, HARD),), shares_of(HARD, ELSEWHERE)
    monkeypatch.setattr(doubt, "fitted", lambda *_: fit_of(model, HARD, HARD))
    assert contested(fit, own, both)

    def impossible(*_: object) -> Fit:
        raise ValueError("cannot be")

    monkeypatch.setattr(doubt, "fitted", impossible)
    assert contested(fit, own, both)


def test_it_is_in_doubt_where_there_is_no_time_to_look(model: Model) -> None:
    fit = fit_of(model, HARD, HARD)
    clock = iter([0.0, *[100.0] * 9])
    assert doubt.contested(fit, ((1.0, HARD),), shares_of(ELSEWHERE), Effort(1.0, lambda: next(clock)))


def test_touches_smaller_than_any_are_in_doubt_unless_larger_ones_have_most_of_the_belief(model: Model) -> None:
    fit, shown = fit_of(model, HARD, HARD), shares_of(HARD)
    assert not contested(fit, ((0.4, SPECK), (0.6, HARD)), shown)
    assert contested(fit, ((0.6, SPECK), (0.4, HARD)), shown)


def test_nothing_found_and_nothing_shown_is_no_doubt(model: Model) -> None:
    none = np.zeros((0, 8))
    fit = fit_of(model, none, none)
    assert not contested(fit, ((1.0, none),), shares_of(none)[:0])
