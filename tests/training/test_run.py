"""A run goes on wherever it was begun, and its loss can be learned with the first sampler."""

from typing import Any

import pytest
import torch

from eitskin_proto.skin.skin import PAPER
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import recipe
from eitskin_training.run import optimiser_of, restore, set_rate

pytestmark = pytest.mark.heavy


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
