"""A network that is narrowed begins as near to the larger one as its ranks allow, and is one where they allow all."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eitskin_proto.errors import MismatchError
from eitskin_training import train
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe, recipe
from eitskin_training.samples.batches import inputs
from eitskin_training.start import Start, fits, narrowed

pytestmark = pytest.mark.heavy

WHOLE = (60, 60, 60, 60)


def of_ranks(*ranks: int, base: Recipe | None = None) -> Recipe:
    base = recipe("tiny") if base is None else base
    return replace(base, architecture=replace(base.architecture, ranks=ranks))


@pytest.fixture(scope="module")
def data(toy_data: Any) -> Any:
    return toy_data("area")


@pytest.fixture(scope="module")
def start(data: Any, tmp_path_factory: pytest.TempPathFactory) -> Start:
    run = tmp_path_factory.mktemp("narrowed") / "run"
    train.train(data, replace(recipe("tiny"), epochs=3, learning_rate=5e-3), run)
    return Start.of_run(run)


def of(found: Start) -> VD2T:
    model = VD2T(found.architecture, found.skin)
    model.load_state_dict(found.weights)
    return model.eval()


def maps(model: VD2T) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    dv = 0.1 * torch.randn(8, 104, generator=generator)
    with torch.inference_mode():
        found: torch.Tensor = model(dv, torch.randn(8, 3, *model.skin.grid.shape, generator=generator))
    return found


def test_with_all_ranks_it_is_the_same_network(data: Any, start: Start) -> None:
    found = narrowed(start, of_ranks(312, *WHOLE[1:]), data)
    expected = maps(of(start))
    torch.testing.assert_close(maps(of(found)), expected, rtol=0, atol=2e-4 * float(expected.abs().max()))
    assert found.facts["narrowed_to"] == [312, 60, 60, 60]
    assert found.facts["data_digest"] == start.facts["data_digest"]


def test_training_goes_on_from_the_larger_network(data: Any, start: Start, tmp_path: Path) -> None:
    chosen = replace(of_ranks(48, 12, 12, 12), epochs=2, learning_rate=2e-3)
    first = train.train(data, chosen, tmp_path / "from", start=start).history[0]
    anew = train.train(data, chosen, tmp_path / "anew").history[0]
    assert first.validation_loss < 0.9 * anew.validation_loss
    again = train.train(data, chosen, tmp_path / "from", start=start, resume=True)
    assert again.started_from is not None
    assert again.started_from["narrowed_to"] == [48, 12, 12, 12]
    np.testing.assert_array_equal(again.model.standardise.mean.numpy(), start.weights["standardise.mean"].numpy())
    assert inputs(data, chosen).shape[1] == 312


def test_only_the_same_shape_is_narrowed(data: Any, start: Start, tmp_path: Path) -> None:
    narrow = of_ranks(48, 12, 12, 12)
    assert fits(start, narrow)
    assert not fits(start, recipe("tiny"))
    assert not fits(replace(start, architecture=narrow.architecture), narrow)
    wider = replace(narrow, architecture=replace(narrow.architecture, hidden=64))
    assert not fits(start, wider)
    with pytest.raises(MismatchError, match="network to start from"):
        train.train(data, wider, tmp_path, start=start)
