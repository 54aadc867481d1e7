"""The verifier of units: exact sets, honest p-values, both signs, time that only helps, and rows that are missing."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.row_gaussian import rows_of as rows_of_electrodes
from eitskin_proto.skin.parts import Map
from eitskin_proto.skin.skin import Skin
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.reduced.exact import ExactSheet, exact_sheet
from eitskin_sim.reduced.making import reduced
from eitskin_sim.reduced.model import rows_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import flat_metric_of
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.verification import units
from eitskin_sim.verification.prior import Prior
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sets.judge import Judge
from eitskin_sim.verification.sets.price import BESIDE, UnitPrice
from eitskin_sim.verification.units import UnitTouch, UnitVerifier
from eitskin_sim.verification.verdict import Verdict

SMALL = Skin(name="small", map=Map((12, 18), (4, 6)))
"""Few, large units: its reduced model takes a second."""

BEND = Bend(angle_deg=110.0, axis_deg=25.0, twist_deg=12.0, stretch_along=1.12, stretch_across=0.96)
UNITS = 24
LONG_S = 60.0
"""A budget that no search here uses up, on the slowest machine."""


@pytest.fixture(scope="module")
def exact() -> ExactSheet:
    return exact_sheet(bend_metric(BEND, Sheet()), SMALL)


@pytest.fixture(scope="module")
def flat() -> np.ndarray:
    return rows_of(exact_sheet(flat_metric_of(SMALL), SMALL).untouched)


@pytest.fixture(scope="module")
def verifier(exact: ExactSheet, flat: np.ndarray) -> UnitVerifier:
    return UnitVerifier(reduced(exact, SMALL), flat)


def bits(units: Sequence[int]) -> np.ndarray:
    found = np.zeros(UNITS, dtype=np.bool_)
    found[list(units)] = True
    return found


def frame(exact: ExactSheet, flat: np.ndarray, contrasts: dict[int, float], law: str, seed: int = 0) -> np.ndarray:
    """Return dV of the exact sheet with noise of 50 dB."""
    volts = rows_of(exact.untouched)
    if contrasts:
        volts = rows_of(exact.currents(np.array(list(contrasts)), np.array(list(contrasts.values())))[1])
    noisy = add_noise(volts, flat, law, 50.0, np.random.default_rng([seed, len(contrasts)]))  # type: ignore[arg-type]
    return relative_change(noisy, flat)


def units_of(verdict: Verdict[UnitTouch]) -> set[int]:
    return {one.unit for one in verdict.touches}


@pytest.mark.parametrize("law", ["N1", "N2", "N3"])
@pytest.mark.parametrize("start", [[9, 14], [9], [], [9, 14, 20], [8, 14], [3, 21]])
def test_from_any_start_the_true_set_is_found(
    exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier, law: str, start: list[int]
) -> None:
    change = frame(exact, flat, {9: 50.0, 14: 50.0}, law)
    verdict = verifier.verify(change, flat, [bits(start)], Noise(law), budget_s=LONG_S)  # type: ignore[arg-type]
    assert units_of(verdict) == {9, 14}
    assert not verdict.flagged
    assert verdict.evaluations < 10 or start != [9, 14]


@pytest.mark.parametrize(
    "contrasts", [{9: 50.0, 14: 0.4, 20: 3.0}, {9: 0.5, 14: 0.5}, {3: 0.2, 9: 8.0, 14: 0.3, 21: 50.0}]
)
def test_units_whose_signs_alone_are_unknown_are_found_at_once(
    exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier, contrasts: dict[int, float]
) -> None:
    change = frame(exact, flat, contrasts, "N2")
    verdict = verifier.verify(change, flat, [bits(list(contrasts))], Noise("N2"), budget_s=LONG_S)
    assert units_of(verdict) == set(contrasts)
    assert not verdict.flagged
    assert all((one.contrast > 1.0) == (contrasts[one.unit] > 1.0) for one in verdict.touches)
    assert verdict.evaluations < 150  # a search for them takes 300 to 1100


def test_a_sheet_that_nothing_touches_has_no_touches(
    exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier
) -> None:
    for start in ([], [5]):
        verdict = verifier.verify(frame(exact, flat, {}, "N2"), flat, [bits(start)], Noise(), budget_s=LONG_S)
        assert units_of(verdict) == set()


@pytest.mark.slow
def test_p_keeps_its_word_where_the_model_is_right(exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier) -> None:
    p = []
    for seed in range(400):
        change = frame(exact, flat, {9: 50.0, 14: 50.0}, "N2", seed)
        p.append(verifier.verify(change, flat, [bits([9, 14])], Noise(), budget_s=0.0).p_value)
    assert np.mean(np.array(p) < 0.01) < 0.03  # 4 expected of 400; 12 or more in one run of a thousand
    assert 0.35 < np.mean(np.array(p) < 0.5) < 0.65


def test_with_no_time_a_wrong_start_is_judged_and_flagged(
    exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier
) -> None:
    change = frame(exact, flat, {9: 50.0, 14: 50.0}, "N2")
    verdict = verifier.verify(change, flat, [bits([9, 13])], Noise(), budget_s=0.0)
    assert units_of(verdict) == {9, 13}
    assert verdict.flagged
    with pytest.raises(ValueError, match="expected 0 or more"):
        verifier.verify(change, flat, [bits([9])], Noise(), budget_s=-1.0)
    with pytest.raises(ValueError, match="truth values"):
        verifier.verify(change, flat, [np.zeros(5)], Noise())


def test_many_units_other_contrasts_and_missing_rows_have_more_time(
    exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier, monkeypatch: pytest.MonkeyPatch
) -> None:
    judges: list[Judge] = []

    class Seen(Judge):
        def __init__(self, *given: object) -> None:
            super().__init__(*given)  # type: ignore[arg-type]
            judges.append(self)

    monkeypatch.setattr(units, "Judge", Seen)
    gone, every = ~rows_of_electrodes((3,)), np.ones(104, dtype=bool)
    many = dict.fromkeys(range(6), 50.0)
    for touched, start, rows in (
        ({9: 50.0}, [9], None), ({9: 50.0}, [9], gone), ({9: 50.0}, list(range(7)), None), (many, list(many), every),
        ({9: 0.2}, [9], None),
    ):  # fmt: skip
        change = frame(exact, flat, touched, "N2")
        verifier.verify(change, flat, [bits(start)], Noise(), rows=rows, clock=lambda: 0.0)
    few, hard = (units.SEARCHED * one for one in (units.BUDGET_S, units.HARD_BUDGET_S))
    assert [one._deadline for one in judges] == [few, hard, hard, few, hard]


def test_more_time_is_never_a_worse_answer(exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier) -> None:
    change = frame(exact, flat, {2: 50.0, 9: 50.0, 14: 50.0, 21: 50.0}, "N3")
    budgets = (0.0, 0.002, 0.02, LONG_S)
    chi = [verifier.verify(change, flat, [bits([8])], Noise("N3"), budget_s=one).chi_squared for one in budgets]
    assert chi[0] > 10.0 * chi[-1]
    assert all(later <= earlier * 1.01 + 20.0 for earlier, later in pairwise(chi))


@pytest.mark.parametrize(
    "contrasts", [{9: 10.0, 14: 10.0}, {9: 200.0}, {9: 0.4}, {9: 0.1, 15: 0.1}, {9: 50.0, 14: 0.4}]
)
def test_contrasts_of_either_sign_are_found_and_measured(
    exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier, contrasts: dict[int, float]
) -> None:
    change = frame(exact, flat, contrasts, "N2")
    verdict = verifier.verify(change, flat, [bits(list(contrasts))], Noise(), budget_s=LONG_S)
    found = {one.unit: one.contrast for one in verdict.touches}
    assert set(found) == set(contrasts)
    for unit, contrast in contrasts.items():
        # Contrast saturates: 200 is hardly told from 150, and 0.1 from 0.12.
        assert abs(np.log(found[unit] / contrast)) < 0.35


def test_the_last_frame_s_touches_are_a_start(exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier) -> None:
    change = frame(exact, flat, {9: 50.0, 14: 3.0}, "N2")
    before = (UnitTouch(9, 50.0), UnitTouch(14, 3.0))
    verdict = verifier.verify(change, flat, [bits([0, 1, 2])], Noise(), budget_s=0.0, before=before)
    assert units_of(verdict) == {9, 14}
    assert not verdict.flagged


@pytest.mark.parametrize("electrode", [0, 6])
def test_one_electrode_gone_leaves_seventy_eight_rows_and_the_same_answer(
    exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier, electrode: int
) -> None:
    change, rows = frame(exact, flat, {9: 50.0, 14: 50.0}, "N2"), ~rows_of_electrodes((electrode,))
    change[~rows] = np.nan
    verdict = verifier.verify(change, flat, [bits([3])], Noise(), rows=rows, budget_s=LONG_S)
    assert verdict.degrees_of_freedom == 78
    assert units_of(verdict) == {9, 14}
    assert not verdict.flagged


def test_what_the_model_does_not_know_is_flagged(exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier) -> None:
    change = frame(exact, flat, {9: 50.0, 14: 50.0}, "N2")
    drifted = (1.0 + change) * 1.03 - 1.0
    verdict = verifier.verify(drifted, flat, [bits([9, 14])], Noise(), budget_s=0.05)
    assert verdict.flagged


def test_heights_say_where_to_look_and_do_not_decide(
    exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier
) -> None:
    change = frame(exact, flat, {9: 50.0, 14: 50.0}, "N2")
    for doubted in ([14, 13], []):  # the second map is sure of a wrong set
        heights = np.where(bits([9, 13]), 0.999, 0.001)
        heights[doubted] = 0.4
        verdict = verifier.verify(change, flat, [bits([9, 13])], Noise(), budget_s=LONG_S, heights=heights)
        assert units_of(verdict) == {9, 14}
        assert not verdict.flagged
    with pytest.raises(ValueError, match="heights of shape"):
        verifier.verify(change, flat, [bits([9])], Noise(), heights=np.zeros(5))


@pytest.mark.parametrize(
    ("contrasts", "start"), [({2: 0.1, 9: 0.1, 20: 0.1}, [2, 9, 19]), ({2: 2.0, 9: 2.0, 20: 2.0}, [2, 9, 20, 22])]
)
def test_a_wrong_set_of_another_contrast_is_put_right(
    exact: ExactSheet, flat: np.ndarray, verifier: UnitVerifier, contrasts: dict[int, float], start: list[int]
) -> None:
    change = frame(exact, flat, contrasts, "N2")
    verdict = verifier.verify(change, flat, [bits(start)], Noise(), budget_s=LONG_S)
    assert units_of(verdict) == set(contrasts)
    assert not verdict.flagged
    assert all(abs(np.log(one.contrast / contrasts[one.unit])) < 0.35 for one in verdict.touches)


def test_the_price_of_each_flip_is_that_of_the_set_after_it() -> None:
    price, usual = UnitPrice((4, 6), Prior(places=UNITS), 50.0), 50.0
    heights = np.random.default_rng(2).random(UNITS)
    price.begin([], heights)
    touched = bits([0, 1, 9, 20])
    before, found = price.of_bits(touched), price.flips(touched)
    for unit in (0, 2, 5, 9, 15, 20):  # no touch is split or joined
        after = touched.copy()
        after[unit] ^= True
        own = np.flatnonzero(after)
        assert price.of(own, np.full(len(own), usual)) - before == pytest.approx(found[unit])
    assert price.doubts.argmin() == np.abs(heights - 0.5).argmin()


def test_units_side_by_side_are_one_touch_and_starts_are_evidence() -> None:
    price = UnitPrice((4, 6), Prior(places=UNITS), 50.0)
    assert price.pieces(np.array([0, 1, 7])) == 1
    assert price.pieces(np.array([0, 7])) == 2  # a corner does not join
    assert price.pieces(np.array([5, 6])) == 2  # the end of a row and the beginning of the next
    price.begin([np.array([0, 1])])
    usual = np.full(2, 50.0)
    assert price.of(np.array([0, 1]), usual) == pytest.approx(Prior(places=UNITS).cost(1) + BESIDE)
    more = price.more(np.array([1, 2]), np.array([0]))
    assert more[1] - more[0] > Prior(places=UNITS).cost(1) - BESIDE
