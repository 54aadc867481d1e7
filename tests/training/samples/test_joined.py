from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eitskin_proto.errors import MismatchError
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.parts import Bend
from eitskin_training.samples.batches import TrainingData, assemble
from eitskin_training.samples.joined import join


@pytest.fixture
def pair(toy_data: Any) -> tuple[TrainingData, TrainingData]:
    one, other = toy_data("area", bends=3), toy_data("area", bends=4)
    rng = np.random.default_rng(5)
    different = replace(
        other,
        digest="other",
        reference=one.reference,
        clouds=other.clouds + rng.normal(size=other.clouds.shape).astype(np.float32),
        labels=rng.integers(0, 256, other.labels.shape, dtype=np.uint8),
    )
    return one, different


def test_sets_of_other_touches_and_devices_are_both(pair: tuple[TrainingData, TrainingData]) -> None:
    one, other = pair
    assert (join(pair).touch_kind, join(pair).drift) == ("raise", None)
    drift = np.full(len(other.voltages), 1.1, dtype=np.float32)
    both = join([one, replace(other, touch_kind="lower", drift=drift)])
    assert both.touch_kind == "both"
    assert both.drift is not None
    np.testing.assert_array_equal(both.drift, np.concatenate([np.ones(len(one.voltages)), drift]).astype(np.float32))


def test_every_sample_keeps_its_voltages_cloud_prediction_and_label(pair: tuple[TrainingData, TrainingData]) -> None:
    both = join(pair)
    assert both.digest == f"{pair[0].digest}+other"
    assert len(both.voltages) == sum(len(one.voltages) for one in pair)
    start = 0
    for one in pair:
        own = np.arange(len(one.voltages))
        rows = own + start
        alone = assemble(one, own, one.voltages, one.log_predicted[one.deformation[own]])
        together = assemble(both, rows, both.voltages[rows], both.log_predicted[both.deformation[rows]])
        for name in ("dv", "log_predicted", "labels"):
            np.testing.assert_array_equal(getattr(together, name), getattr(alone, name))
        np.testing.assert_array_equal(together.clouds[together.which], alone.clouds[alone.which])
        start += len(own)


def test_what_one_set_holds_out_stays_held_out(pair: tuple[TrainingData, TrainingData]) -> None:
    first = replace(pair[0], held_out={"A": pair[0].validation[:4]})
    second = replace(pair[1], held_out={"A": pair[1].validation[:4], "B": pair[1].validation[4:]})
    both = join((first, second))
    start = len(first.voltages)
    np.testing.assert_array_equal(both.train, np.concatenate([first.train, second.train + start]))
    np.testing.assert_array_equal(both.validation, np.concatenate([first.validation, second.validation + start]))
    in_a = np.concatenate([first.held_out["A"], second.held_out["A"] + start])
    np.testing.assert_array_equal(both.held_out["A"], in_a)
    np.testing.assert_array_equal(both.held_out["B"], second.held_out["B"] + start)
    assert not set(both.touch_set[both.train]) & set(both.touch_set[both.validation])


def test_bends_that_another_set_learned_from_are_held_out_no_more(pair: tuple[TrainingData, TrainingData]) -> None:
    few, many = draw("A", 3, 4), (*draw("A", 3, 4)[:2], Bend(), draw("A", 3, 4)[2])
    # of one seed and of two sizes: what the first keeps apart, its last, the second learns from; flat sheets are alike
    first = replace(pair[0], bends=few, held_out={"A": _at(pair[0], 2)}, train=_at(pair[0], 0))
    second = replace(pair[1], bends=many, held_out={"A": _at(pair[1], 2)}, train=_at(pair[1], 2, 3))
    both = join((first, second))
    np.testing.assert_array_equal(both.held_out["A"], second.held_out["A"] + len(first.voltages))
    assert both.bends == (*few, *many)
    unknown = join((first, replace(second, bends=())))
    np.testing.assert_array_equal(unknown.held_out["A"][: len(first.held_out["A"])], first.held_out["A"])
    nothing = join((first, replace(second, held_out={})))
    assert nothing.held_out == {}


def _at(data: TrainingData, *bends: int) -> Any:
    return np.flatnonzero(np.isin(data.deformation, bends))


def test_sets_that_do_not_go_together_are_refused(pair: tuple[TrainingData, TrainingData]) -> None:
    one, other = pair
    assert join([one]) is one
    for second, message in (
        (one, "twice"),
        (replace(other, labels_kind="units"), "labels_kind"),
        (replace(other, reference=1.01 * other.reference), r"reference.*1\.0e-02"),
    ):
        with pytest.raises(MismatchError, match=message):
            join((one, second))
