"""Splits: by touch set and by deformation, so that nothing that is tested was ever learned from."""

import numpy as np
import pytest

from eitskin_sim.dataset.plan import Plan, make_plan
from eitskin_sim.dataset.shards import freeform_sets
from eitskin_sim.scene.family import bounds, draw, paper_bend, paper_bends
from eitskin_sim.scene.folds import check_bend
from eitskin_sim.scene.parts import Bend, Sheet


@pytest.fixture(scope="module")
def plan() -> Plan:
    return make_plan("units", 5, deformations=6, touch_sets=400, per_deformation=60, kept=2)


def test_a_tenth_of_the_touch_sets_is_held_out(plan: Plan) -> None:
    assert plan.validation().sum() == 40
    assert np.array_equal(plan.validation(), plan.validation())


def test_bends_kept_apart_show_only_touch_sets_that_were_held_out(plan: Plan) -> None:
    held = plan.validation()
    for number, split in enumerate(plan.splits):
        shown = plan.shown(number)
        assert len(np.unique(shown)) == len(shown)
        if split == "train":
            assert len(shown) == 60
            assert 0 < held[shown].sum() < 20
        else:
            assert held[shown].all()


def test_no_bend_is_in_two_splits_and_family_b_is_never_trained_on(plan: Plan) -> None:
    assert plan.splits == ("train",) * 6 + ("kept",) * 2 + ("other",) * 2
    trained = {bend for bend, split in zip(plan.bends, plan.splits, strict=True) if split == "train"}
    flat = {Bend()}
    for bend, split in zip(plan.bends, plan.splits, strict=True):
        if split != "train":
            assert bend not in trained - flat
        assert bool(bend.bumps_mm) == (split == "other") or bend == Bend()


def test_deformations_that_are_made_together_are_of_one_group_and_one_split() -> None:
    plan = make_plan("free", 1, deformations=5, per_deformation=50, kept=2)
    for shard in plan.shards():
        assert len(shard) <= plan.group
        assert len({plan.splits[number] for number in shard}) == 1
    assert sorted(number for shard in plan.shards() for number in shard) == list(range(9))


def test_a_touch_that_is_held_out_is_in_no_set_that_is_learned_from() -> None:
    plan = make_plan("free", 3, deformations=3, per_deformation=80, kept=1)
    table, held = freeform_sets(plan), plan.validation()
    assert len(table) == plan.touch_sets == len(held)

    def pieces(numbers: np.ndarray) -> set[bytes]:
        return {piece.tobytes() for number in numbers for piece in table.of(int(number))}

    learned, apart = pieces(np.flatnonzero(~held)), pieces(np.flatnonzero(held))
    assert len(learned) > 50
    assert len(apart) > 50
    assert not learned & apart


def test_the_papers_set_shows_everything_at_every_bend() -> None:
    plan = make_plan("paper")
    assert sum(len(plan.shown(number)) for number in range(len(plan.bends))) == 102_590
    assert plan.bends == paper_bends()


def test_sizes_that_cannot_be_are_refused_with_their_bounds() -> None:
    with pytest.raises(ValueError, match="found 10260, expected 10 to 10259"):
        make_plan("paper", touch_sets=10_260)
    with pytest.raises(ValueError, match="shown at a deformation: found 500, expected 1 to 400"):
        make_plan("units", touch_sets=400, per_deformation=500)
    with pytest.raises(ValueError, match="set 'mm' is unknown; expected one of paper, units, free"):
        make_plan("mm")
    with pytest.raises(ValueError, match="touch sets: found 90, expected none for the free set"):
        make_plan("free", touch_sets=90)
    with pytest.raises(ValueError, match=r"share of near touches: found 1\.2, expected 0 to 1"):
        make_plan("free", near=1.2)
    with pytest.raises(ValueError, match="shown at a deformation: found 10, expected none for the paper's set: each"):
        make_plan("paper", per_deformation=10)
    with pytest.raises(ValueError, match="held-out deformations: found 1, expected none: the paper's set trains on"):
        make_plan("paper", kept=1)
    with pytest.raises(ValueError, match="only the free set"):
        make_plan("units", near=0.5)
    with pytest.raises(ValueError, match="seed is -1"):
        make_plan("paper", -1)


def test_paper_family_is_the_published_phantoms_bends() -> None:
    bend = paper_bend(5 / 9)
    assert bend.angle_deg == pytest.approx(100.0)
    assert bend.stretch_along == pytest.approx(1.061373, abs=1e-6)
    assert bend.stretch_across == pytest.approx(0.985219, abs=1e-6)
    assert bend.nonuniformity == pytest.approx(0.05556, abs=1e-5)
    assert paper_bends()[0] == Bend()
    with pytest.raises(ValueError, match=r"q is 1\.5"):
        paper_bend(1.5)


def test_family_a_draws_all_parameters_apart_some_scaled_and_some_flat() -> None:
    bends = draw("A", 16, 11)
    assert bends[:3] == draw("A", 3, 11)
    for name, (low, high) in bounds().items():
        values = np.array([getattr(bend, name) for bend in bends])
        assert np.all((values >= low) & (values <= high))
        assert values.std() > 0.08 * (high - low)
    table = np.array([[getattr(bend, name) for name in bounds()] for bend in bends])
    away = np.abs(np.corrcoef(table, rowvar=False) - np.eye(len(bounds())))
    assert away.max() < 0.8  # 16 independent draws: 0.26 rms, 0.75 at three sigma; one common parameter gives 1
    check_bend(bends[0], Sheet())
