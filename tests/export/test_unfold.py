"""A network that was folded, exported and taken apart again gives the maps that it gave, and can be exported again."""

import numpy as np
import pytest
import torch

from eitskin_export import graphs
from eitskin_export.fold import split
from eitskin_export.unfold import unfolded
from eitskin_proto.skin.skin import PAPER
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe

from .test_graphs import ARCHITECTURES, trained_looking

pytestmark = [pytest.mark.slow, pytest.mark.heavy]

NAMES = ("units", "predicted", "sharpened", "symmetric", "narrow", "narrow units", "symmetric units")


def _recipe(name):
    architecture = ARCHITECTURES[name]
    return Recipe(name=name, labels="units" if architecture.outputs == "units" else "area", architecture=architecture)


def _graphs(model):
    geometry, head = split(model)
    return graphs.geometry_graph(geometry), graphs.head_graph(head)


def _maps(model: VD2T, seed=3):
    generator = torch.Generator().manual_seed(seed)
    dv, clouds, predicted = (
        torch.randn(size, generator=generator) * scale
        for size, scale in (((6, 104), 0.1), ((6, 3, 30, 45), 0.5), ((6, 104), 0.1))
    )
    with torch.inference_mode():
        return model.logits(dv, model.bias(clouds), predicted).numpy()


@pytest.fixture(scope="module", params=NAMES)
def exported(request):
    """A network's name, the network, its graphs, and those of the network that was made of them."""
    model = trained_looking(ARCHITECTURES[request.param])
    first = _graphs(model)
    return request.param, model, first, _graphs(unfolded(*first, _recipe(request.param), PAPER))


def test_the_same_network_comes_back(exported):
    name, model, first, second = exported
    expected = _maps(model)
    # folding rounds once, and float32 sums of 1,000 products differ by 1e-5 of their size
    np.testing.assert_allclose(
        _maps(unfolded(*first, _recipe(name), PAPER)), expected, atol=1e-4 * np.abs(expected).max()
    )
    np.testing.assert_allclose(
        _maps(unfolded(*second, _recipe(name), PAPER)), expected, atol=1e-4 * np.abs(expected).max()
    )
