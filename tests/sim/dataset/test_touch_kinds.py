"""Data sets of touches both ways: what they keep of every touch, and that those of hard touches are as before."""

from pathlib import Path

import numpy as np
import pytest

from eitskin_proto.skin.toml import named, to_toml
from eitskin_sim.dataset.generate import generate
from eitskin_sim.dataset.index import touch_kind_of
from eitskin_sim.dataset.plan import make_plan
from eitskin_sim.dataset.reader import load
from eitskin_sim.dataset.shards import unit_contrasts
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.parts import Scene


def test_plans_of_hard_touches_have_the_digests_that_they_had() -> None:
    assert make_plan("paper").digest == "3fe918561299c976"
    assert make_plan("units", 7, deformations=2, kept=1).digest == "86c340180e3fefd7"
    assert make_plan("free", 7, deformations=2, kept=1).digest == "111ce3044df791a2"


@pytest.mark.parametrize("name", ["units", "free"])
def test_a_kind_of_touches_is_part_of_the_plan(name: str) -> None:
    kinds = ("hard", "firm", "press", "raise", "both")
    digests = {make_plan(name, 7, deformations=2, touches=kind).digest for kind in kinds}
    assert len(digests) == len(kinds)
    assert make_plan(name, 7, deformations=2).touches == "hard"


def test_what_no_set_has_is_refused() -> None:
    with pytest.raises(ValueError, match="touches: found 'press', expected 'hard': the paper's set follows"):
        make_plan("paper", touches="press")
    with pytest.raises(
        ValueError, match="touches 'soft' are unknown; expected one of hard, firm, press, raise, both, skin"
    ):
        make_plan("free", touches="soft")


@pytest.mark.parametrize(("said", "way"), [({}, "raise"), ({"touch_kind": "raise"}, "raise")])
def test_a_set_says_which_way_its_touches_go(said: dict[str, str], way: str) -> None:
    assert touch_kind_of(said) == way
    assert touch_kind_of({"touch_kind": "press"}) == "lower"
    hydrogel = named("hydrogel")
    own = {"touch_kind": "skin", "skin": to_toml(hydrogel), "skin_digest": hydrogel.digest}
    assert touch_kind_of(own) == "lower"
    for wrong in ("soft", 1):
        with pytest.raises(ValueError, match=r"touch_kind is .*, expected one of hard, firm, press, raise, both, skin"):
            touch_kind_of({"touch_kind": wrong})


@pytest.mark.heavy
def test_a_free_set_of_both_ways_keeps_contrast_border_and_shape_and_labels_outlines(tmp_path: Path) -> None:
    plan = make_plan("free", 3, deformations=1, kept=0, per_deformation=60, touches="both")
    index = generate(plan, tmp_path, workers=0)
    data = load(tmp_path)
    assert (index["touch_kind"], index["version"], index["digest"]) == ("both", 2, data.digest)
    assert data.touch_kind == "both"
    assert data.free.pieces.shape[1] == 8
    contrast = data.free.pieces[:, 6]
    assert 0.2 < np.mean(contrast < 1.0) < 0.8
    assert data.free.pieces[:, 7].max() > 4.0
    single = next(n for n in range(60) if len(data.free.of(n)) == 1 and data.free.of(n)[0, 6] < 1.0)
    touches = data.free.touches(single)
    assert data.labels(np.array([single]))[0].sum() * (10 / 3) ** 2 == pytest.approx(
        sum(shape.area_mm2 for touch in touches for shape in touch.shapes), rel=2e-3
    )
    scene = Scene(bend=data.bends[0], touches=touches, element_size_mm=3.0)
    exact = solve_scene(scene).voltages / solve_scene(scene.untouched()).voltages - 1.0
    found = data.voltages_V[single] / data.untouched_V[0] - 1.0
    assert np.linalg.norm(found - exact) < 0.06 * np.linalg.norm(exact)


@pytest.mark.heavy
@pytest.mark.slow
def test_a_unit_set_keeps_the_contrast_of_every_touched_unit(tmp_path: Path) -> None:
    plan = make_plan("units", 3, deformations=1, kept=0, touch_sets=40, touches="press")
    generate(plan, tmp_path, workers=0)
    data = load(tmp_path)
    own = unit_contrasts(plan)
    assert data.unit_contrasts is not None
    assert np.array_equal(data.unit_contrasts.number, own.number)
    for number in range(40):
        contrast = data.unit_contrasts.of(np.array([number]))[0]
        assert np.array_equal(contrast != 1.0, data.units[number])
        assert np.all((contrast[data.units[number]] >= 0.2) & (contrast[data.units[number]] <= 0.85))
    change = np.abs(data.voltages_V / data.untouched_V[data.deformation] - 1.0).max(axis=1)
    touched = data.units[data.touch_set].any(axis=1)
    assert change[touched].min() > 0.01  # before, every one of them was untouched
    assert change[~touched].max(initial=0.0) < 1e-6
