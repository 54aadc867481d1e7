import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tests.second_skin import SECOND

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.skin.skin import PAPER
from eitskin_training import run_files, train
from eitskin_training.recipes import Recipe, recipe
from eitskin_training.samples.batches import inputs
from eitskin_training.score import correlations, loss_of, score
from eitskin_training.start import Start

pytestmark = pytest.mark.heavy


def tiny(labels: str = "area", **changes: Any) -> Recipe:
    return replace(recipe("tiny"), labels=labels, **changes)


def test_a_resumed_run_equals_one_that_never_stopped(toy_data: Any, tmp_path: Path) -> None:
    data, chosen = toy_data("area", samples=300), tiny(epochs=2)
    whole = train.train(data, chosen, tmp_path / "whole", seed=5)
    train.train(data, chosen, tmp_path / "parts", seed=5, stop_after=1)
    parts = train.train(data, chosen, tmp_path / "parts", seed=5, resume=True)
    assert [epoch.validation_loss for epoch in parts.history] == [epoch.validation_loss for epoch in whole.history]
    for name, value in whole.model.state_dict().items():
        assert torch.equal(value, parts.model.state_dict()[name]), name


def test_training_learns_and_the_best_epoch_is_what_is_kept(toy_data: Any, tmp_path: Path) -> None:
    data = toy_data("area", samples=1000)
    run = train.train(data, tiny(epochs=6, learning_rate=8e-3), tmp_path)
    losses = [epoch.validation_loss for epoch in run.history]
    assert min(losses) < 0.8 * losses[0]
    content = run_files.read(tmp_path / "best.pt")
    kept = run_files.network(run.recipe, content["weights"], PAPER)
    again = score(kept, data, data.validation, run.recipe.noises)
    assert again.loss == pytest.approx(min(losses), rel=1e-5)
    assert run.best is not None
    assert len(content["history"]) == run.best.number
    assert json.loads((tmp_path / "history.json").read_text())[-1]["number"] == 6


def test_a_run_is_not_overwritten_or_resumed_with_something_else(toy_data: Any, tmp_path: Path) -> None:
    data = toy_data("area")
    train.train(data, tiny(epochs=1), tmp_path, seed=0)
    with pytest.raises(SkinError, match="--resume"):
        train.train(data, tiny(epochs=1), tmp_path, seed=0)
    with pytest.raises(MismatchError, match="seed: found 0, expected 1"):
        train.train(data, tiny(epochs=1), tmp_path, seed=1, resume=True)
    with pytest.raises(MismatchError, match="data digest"):
        train.train(replace(data, digest="other"), tiny(epochs=1), tmp_path, resume=True)


def test_a_run_begins_where_another_ended_and_says_so(toy_data: Any, tmp_path: Path) -> None:
    data, other = toy_data("area"), replace(toy_data("area"), digest="other")
    first = train.train(data, tiny(epochs=2, learning_rate=5e-3), tmp_path / "first", seed=3)
    chosen = tiny(epochs=2, learning_rate=0.0, schedule="constant", weight_decay=0.0)
    later = train.train(other, chosen, tmp_path / "later", seed=4, start=Start.of_run(tmp_path / "first"), stop_after=1)
    kept = run_files.read(tmp_path / "first" / "best.pt")
    for name, value in later.averaged.items():  # nothing was learned, so these are the first run's, inputs' scale too
        if "running_" not in name and "num_batches" not in name:
            assert torch.equal(value, kept["weights"][name]), name
    told = run_files.read(tmp_path / "later" / "best.pt")["started_from"]
    assert told == {"seed": 3, "data_digest": data.digest, "epochs": len(kept["history"]), "started_from": None}
    assert first.started_from is None
    with pytest.raises(MismatchError, match="run it started from"):
        train.train(other, chosen, tmp_path / "later", seed=4, resume=True)
    with pytest.raises(MismatchError, match="network"):
        train.train(other, recipe("free"), tmp_path / "else", start=Start.of_run(tmp_path / "first"))
    with pytest.raises(SkinError, match="no finished epoch"):
        train.train(other, chosen, tmp_path / "none", start=Start.of_run(tmp_path / "nothing"))


def test_statistics_stay_where_they_are_part_of_the_weights(toy_data: Any, tmp_path: Path) -> None:
    data, chosen = toy_data("area", samples=300), tiny(epochs=2, learning_rate=1e-3)
    train.train(data, chosen, tmp_path / "first", seed=3)
    start = Start.of_run(tmp_path / "first")
    still = replace(start, facts={**start.facts, "still": True})
    kept = train.train(data, chosen, tmp_path / "still", seed=4, start=still, stop_after=1)
    kept = train.train(data, chosen, tmp_path / "still", seed=4, start=still, resume=True)  # and after a stop
    moved = train.train(data, chosen, tmp_path / "moved", seed=4, start=start)
    for run, same in ((kept, True), (moved, False)):
        for name, value in run.model.state_dict().items():
            if "running_" in name:
                assert torch.equal(value, start.weights[name]) == same, name
    assert Start.of_run(tmp_path / "still").facts["still"]


def test_a_run_carries_the_skin_of_its_data_and_one_without_is_the_papers(toy_data: Any, tmp_path: Path) -> None:
    data = toy_data("area", samples=200, skin=SECOND)
    train.train(data, tiny(epochs=1), tmp_path / "run")
    found = run_files.trained(tmp_path / "run")
    assert found.skin == SECOND
    maps = found.model.maps(found.model(torch.zeros(1, 104), torch.zeros(1, 3, *SECOND.grid.shape)))
    assert maps.shape == (1, SECOND.grid.n_pixels)
    content = run_files.read(tmp_path / "run" / "best.pt")
    older = {name: value for name, value in content.items() if name not in ("skin", "skin_digest")}
    run_files.write_file(tmp_path / "best.pt", older)
    with pytest.raises(MismatchError, match=f"grid_id: found {SECOND.grid_id}, expected {PAPER.grid_id}"):
        run_files.read(tmp_path / "best.pt")
    run_files.write_file(tmp_path / "best.pt", {**older, "grid_id": PAPER.grid_id})
    assert run_files.skin_of(run_files.read(tmp_path / "best.pt"), tmp_path) is PAPER
    run_files.write_file(tmp_path / "best.pt", {**content, "skin_digest": "0123"})
    with pytest.raises(MismatchError, match="skin_digest: found 0123"):
        run_files.read(tmp_path / "best.pt")
    run_files.write_file(tmp_path / "best.pt", {**content, "skin": "no skin"})
    with pytest.raises(SkinError, match="train again"):
        run_files.read(tmp_path / "best.pt")


def test_a_run_goes_on_and_starts_with_data_of_its_own_skin_alone(toy_data: Any, tmp_path: Path) -> None:
    second, paper = toy_data("units", samples=200, skin=SECOND), toy_data("units", samples=200)
    plain = replace(recipe("units"), epochs=1, batch=64)
    plain = replace(plain, architecture=replace(plain.architecture, widths=(16, 16), hidden=16))
    train.train(second, plain, tmp_path / "run")
    with pytest.raises(MismatchError, match=f"skin_digest: found {SECOND.digest}, expected {PAPER.digest}"):
        train.train(paper, plain, tmp_path / "run", resume=True)
    with pytest.raises(MismatchError, match="map: found 18 x 45 pixels, 9 x 15 units, mirror images: xy, expected 30"):
        train.train(paper, plain, tmp_path / "other", start=Start.of_run(tmp_path / "run"))


def test_labels_that_the_recipe_does_not_learn_from_are_refused(toy_data: Any, tmp_path: Path) -> None:
    with pytest.raises(MismatchError, match="found units, expected area"):
        train.train(toy_data("units"), tiny(), tmp_path)


def test_a_checkpoint_of_another_protocol_or_no_checkpoint_is_refused(tmp_path: Path) -> None:
    torch.save({"format": 1, "protocol_id": "0123", "grid_id": "4567"}, tmp_path / "best.pt")
    with pytest.raises(MismatchError, match="protocol_id: found 0123"):
        run_files.read(tmp_path / "best.pt")
    (tmp_path / "best.pt").write_bytes(b"not a checkpoint")
    with pytest.raises(SkinError, match="not a file of a training run"):
        run_files.read(tmp_path / "best.pt")
    with pytest.raises(SkinError, match="eitskin train"):
        run_files.read(tmp_path / "missing.pt")


def test_a_loss_that_is_no_number_stops_the_run(toy_data: Any, tmp_path: Path) -> None:
    data = toy_data("area")
    data.clouds[:] = np.nan
    with pytest.raises(SkinError, match="not a number"):
        train.train(data, tiny(epochs=1), tmp_path)


def test_the_loss_over_units_equals_the_loss_over_their_pixels(toy_data: Any) -> None:
    generator = torch.Generator().manual_seed(0)
    logits = torch.randn(4, 126, generator=generator)
    labels = (torch.rand(4, 126, generator=generator) < 0.1).float()
    spread = torch.from_numpy(train.VD2T(recipe("paper").architecture, PAPER).get_buffer("unit_of_pixel").numpy())
    torch.testing.assert_close(
        loss_of(logits, labels, PAPER.grid), loss_of(logits[:, spread], labels[:, spread], PAPER.grid)
    )
    torch.testing.assert_close(
        loss_of(logits[:, spread], labels, PAPER.grid), loss_of(logits[:, spread], labels[:, spread], PAPER.grid)
    )


def test_correlation_is_pearsons_and_zero_for_a_constant_map() -> None:
    rng = np.random.default_rng(0)
    maps, truth = rng.random((3, 1350)), rng.random((3, 1350))
    maps[2] = 0.5
    expected = [np.corrcoef(maps[i], truth[i])[0, 1] for i in range(2)]
    np.testing.assert_allclose(correlations(maps, truth), [*expected, 0.0], atol=1e-12)


def test_inputs_are_standardised_by_the_training_data(toy_data: Any, tmp_path: Path) -> None:
    data, chosen = toy_data("area"), tiny(epochs=1)
    run = train.train(data, chosen, tmp_path)
    x = run.model.standardise(inputs(data, chosen))
    assert float(x.mean(dim=0).abs().max()) < 1e-4
    moving = x.std(dim=0) > 0.5
    assert moving.float().mean() > 0.9
    torch.testing.assert_close(x.std(dim=0)[moving], torch.ones(int(moving.sum())), rtol=0, atol=1e-3)
