"""Data sets of random devices: what they keep, what divides out, and that they are read as any other."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eitskin_proto.skin.parts import Doubts, Instrument, Outline
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import named, parse
from eitskin_sim.dataset.generate import generate
from eitskin_sim.dataset.plan import Plan, make_plan
from eitskin_sim.dataset.reader import load
from eitskin_sim.dataset.shards import Arrays, make_shard, reference, shard_job

pytestmark = pytest.mark.slow

DRIFTING = replace(PAPER, may_be_off=Doubts(drift=Quantity(0.0, "normal", 0.02)))


def plan_of(name: str = "free", skin: Skin | None = None, **more: int) -> Plan:
    size = {"touch_sets": 30} if name == "units" else {}
    more = {"deformations": 1, "kept": 0, "per_deformation": 12, **size, **more}
    return make_plan(name, 3, devices="ideal" if skin is None else "random", skin=skin, touches="both", **more)


def shard(plan: Plan, number: int = 0) -> Arrays:
    return make_shard(shard_job(plan, [number]))[0]


@pytest.fixture(scope="module")
def ideal() -> Arrays:
    return shard(plan_of())


@pytest.fixture(scope="module")
def same() -> Arrays:
    return shard(plan_of(skin=PAPER))


# The untouched sheet is solved with elements of 3 mm in place of 1.5.
def test_a_skin_without_doubts_gives_the_ideal_data(ideal: Arrays, same: Arrays) -> None:
    assert same["voltages"] == pytest.approx(ideal["voltages"], rel=3e-4)
    assert same["untouched"] == pytest.approx(ideal["untouched"], rel=3e-4)
    assert np.all(same["drift"] == 1.0)


def test_drift_multiplies_what_a_sample_reads(same: Arrays) -> None:
    drifted = shard(plan_of(skin=DRIFTING))
    assert drifted["drift"].std() > 1e-3
    assert drifted["voltages"] == pytest.approx(same["voltages"] * drifted["drift"][:, None], rel=1e-6)
    assert drifted["untouched"] == pytest.approx(same["untouched"], rel=1e-12)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Plan]:
    folder, plan = tmp_path_factory.mktemp("random"), plan_of(skin=named("hydrogel"), deformations=3, kept=1)
    generate(plan, folder, workers=0)
    return folder, plan


def test_the_index_says_whose_devices_and_the_reader_needs_to_know_nothing(written: tuple[Path, Plan]) -> None:
    folder, _ = written
    index = json.loads((folder / "index.json").read_text())
    assert (index["devices"], index["skin_digest"]) == ("random", named("hydrogel").digest)
    assert parse(index["skin"]).may_be_off.layer_rms == (0.0, 0.1)
    data = load(folder)
    assert data.reference_V == pytest.approx(reference())
    assert data.voltages_V.shape == (60, 104)
    change = np.abs(data.untouched_V / data.reference_V - 1.0)
    assert 0.0 < np.median(change) < 0.5
    for number in range(3):
        with np.load(folder / f"deformation-{number:04d}.npz") as file:
            assert np.all(file["reference"] / reference() > 0.4)


def test_the_reader_names_skin_touches_and_every_samples_drift(written: tuple[Path, Plan]) -> None:
    folder, plan = written
    data = load(folder)
    assert data.drift is not None
    assert (data.skin, data.touch_kind) == (plan.skin, "both")
    with np.load(folder / "deformation-0001.npz") as file:
        np.testing.assert_array_equal(data.drift[data.deformation == 1], file["drift"])


def test_deformations_made_together_have_one_device_and_others_another(written: tuple[Path, Plan]) -> None:
    folder, plan = written
    references = [np.load(folder / f"deformation-{number:04d}.npz")["reference"] for number in range(5)]
    assert plan.shards() == [[0, 1], [2], [3], [4]]
    assert np.array_equal(references[0], references[1])
    assert len({one.tobytes() for one in references}) == 4


def test_one_deformation_alone_is_the_same_to_the_last_bit(written: tuple[Path, Plan]) -> None:
    folder, plan = written
    alone = shard(plan, 1)
    with np.load(folder / "deformation-0001.npz") as file:
        assert all(np.array_equal(file[name], alone[name]) for name in file)


def test_what_cannot_be_meant_is_refused() -> None:
    with pytest.raises(ValueError, match="devices 'odd' are unknown; expected one of ideal, random"):
        make_plan("free", devices="odd")
    with pytest.raises(ValueError, match="devices: found 'random', expected 'ideal': the paper's set follows"):
        make_plan("paper", devices="random")
    with pytest.raises(ValueError, match=r"\[outline\] kind is 'disc', expected 'rectangle'"):
        make_plan("free", skin=replace(PAPER, outline=Outline("disc", (170.0, 170.0))))
    wild = replace(PAPER, front_end=Instrument(gain=Quantity(5.0)))
    with pytest.raises(ValueError, match=r"in 100 draws of its front end none read every row within 0.4 and 2.5 times"):
        shard(plan_of(skin=wild))
