"""A run goes on wherever it was begun, and its loss can be learned with the first sampler."""

from typing import Any

import pytest
import torch

from eitskin_proto.skin.skin import PAPER
from eitskin_training import score as score_module
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import recipe
from eitskin_training.run import optimiser_of, restore, set_rate
from eitskin_training.score import loss_of

pytestmark = pytest.mark.heavy


def test_a_loss_that_was_asked_for_in_inference_first_can_be_learned_with(toy_data: Any) -> None:
    grid = toy_data("units").skin.grid
    for cached in (score_module._weight_of_units, score_module._units_of_pixels):
        cached.cache_clear()
    units = torch.zeros(2, grid.n_units)
    for outputs in (grid.n_units, grid.n_pixels):
        with torch.inference_mode():
            known = float(loss_of(torch.ones(2, outputs), units, grid))
        logits = torch.ones(2, outputs, requires_grad=True)
        loss = loss_of(logits, units, grid)
        loss.backward()
        assert float(loss.detach()) == pytest.approx(known)
        assert logits.grad is not None


def test_an_optimiser_goes_on_from_a_run_on_a_gpu() -> None:
    chosen, cpu = recipe("tiny"), torch.device("cpu")

    def made() -> Any:
        torch.manual_seed(0)
        model = VD2T(chosen.architecture, PAPER)
        return model, optimiser_of(model, chosen, cpu)

    (model, plain), (other, gpu_like) = made(), made()
    for own, optimiser in ((model, plain), (other, gpu_like)):
        own.out.weight.grad = torch.ones_like(own.out.weight)
        optimiser.step()
    state = gpu_like.state_dict()
    for group in state["param_groups"]:
        group |= {"capturable": True, "lr": torch.tensor(0.5)}
    restore(gpu_like, state)
    for optimiser in (plain, gpu_like):
        set_rate(optimiser, chosen, 1, 10)
        optimiser.step()
    assert torch.equal(model.out.weight, other.out.weight)
