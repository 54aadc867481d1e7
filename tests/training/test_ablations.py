from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eitskin_training.ablations import VARIANTS, ablate, variant_data, variant_recipe, wrong_shapes
from eitskin_training.recipes import recipe

pytestmark = pytest.mark.heavy


def test_every_variant_changes_the_inputs_and_nothing_else() -> None:
    base = recipe("tiny")
    blocks = {name: variant_recipe(base, name).architecture.feature_blocks for name in VARIANTS}
    without = {"none": 2, "cloud": 2, "paper-cloud": 2}
    assert blocks == without | {name: 3 for name in VARIANTS if name not in without}
    as_wide = set(VARIANTS) - {"unmirrored"}  # as many weights a frame instead: tests/training/network/test_images.py
    assert {variant_recipe(base, name).architecture.widths for name in as_wide} == {base.architecture.widths}
    with pytest.raises(ValueError, match="variant 'voltages' is unknown"):
        variant_recipe(base, "voltages")
    with pytest.raises(ValueError, match="'paper' knows no symmetry"):
        variant_recipe(recipe("paper"), "unmirrored")


def test_parts_of_the_network_are_left_out_one_at_a_time() -> None:
    base = recipe("free")
    whole = variant_recipe(base, "both")
    for name, changed in (
        ("unsharpened", replace(whole, architecture=replace(whole.architecture, sharpening=()))),
        ("cross-entropy", replace(whole, correlation_weight=0.0)),
    ):
        assert (
            variant_recipe(base, name) == replace(changed, name=f"free-{name}") != replace(whole, name=f"free-{name}")
        )


def test_fewer_deformations_do_not_mean_fewer_samples(toy_data: Any) -> None:
    data = toy_data("area")
    few = variant_data(data, "none", 2, 150, 0)
    assert len(few.train) == 150
    assert len(np.unique(few.deformation[few.train])) == 2


def test_the_true_reference_takes_the_place_of_the_prediction(toy_data: Any) -> None:
    data = toy_data("area")
    post = variant_data(data, "post", None, 50, 0)
    np.testing.assert_allclose(np.exp(post.log_predicted), data.untouched / data.reference, rtol=1e-5)


def test_a_wrong_shape_is_another_deformations_of_the_same_split(toy_data: Any) -> None:
    data = toy_data("area")
    mixed = wrong_shapes(data, 0)
    for rows in (data.train, *data.held_out.values()):
        own = np.unique(data.deformation[rows])
        found = {cloud.tobytes() for cloud in mixed.clouds[own]}
        assert found == {cloud.tobytes() for cloud in data.clouds[own]}
        if len(own) > 1:
            assert not any(np.array_equal(mixed.clouds[i], data.clouds[i]) for i in own)


def test_variants_are_trained_and_scored_side_by_side(toy_data: Any) -> None:
    data = toy_data("area")
    with pytest.raises(ValueError, match="no deformations of B apart"):
        next(ablate(data, recipe("tiny"), [("none", None)], samples=128))
    data = replace(data, held_out={**data.held_out, "B": data.held_out["A"]})
    results = list(ablate(data, recipe("tiny"), [("none", None), ("predicted", 2)], samples=128))
    assert [one.variant for one in results] == ["none", "predicted"]
    assert results[0].cc_wrong_A is None
    assert results[1].cc_wrong_A is not None
    assert results[1].deformations == 2
    for one in results:
        assert -1.0 <= one.cc_A <= 1.0
        assert 0.0 <= one.untouched_share <= 1.0
