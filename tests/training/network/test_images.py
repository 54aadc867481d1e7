"""A symmetric network: what it makes of a mirror image is the image of what it makes."""

from dataclasses import replace

import pytest
import torch
from tests.training.network.skins import ALL, SKINS
from torch import nn

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_training.network import images
from eitskin_training.network.architecture import Architecture, Outputs
from eitskin_training.network.images import ImageLinear, Parts
from eitskin_training.network.mirror import mirrors, of_outputs
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import fitted, recipe

SMALL = Architecture(
    widths=(24, 24), cloud_channels=(4, 4), hidden=20, log_predicted=True, activation="silu", symmetric=True
)


def shuffled(x: torch.Tensor, mirror: int) -> torch.Tensor:
    """The images of a mirrored sheet: image g of the one is image g-then-mirror of the other."""
    return x[[image ^ mirror for image in range(len(x))]]


@pytest.mark.parametrize(("count", "mirror"), [(n, mirror) for n in (1, 2, 4) for mirror in range(n)])
def test_a_layer_commutes_with_mirrors_and_is_no_multiple_of_one(count: int, mirror: int) -> None:
    torch.manual_seed(1)
    layer, x = ImageLinear(count, 6, 5, bias=True).double(), torch.randn(count, 3, 6, dtype=torch.float64)
    layer.signs = count**-0.5 * torch.from_numpy(images.signs(count)).double()
    torch.testing.assert_close(layer(shuffled(x, mirror)), shuffled(layer(x), mirror))
    alone = layer(x * (torch.arange(count) == 0)[:, None, None])
    assert all(alone[image].std() > 0 for image in range(count))  # every image reads every other


@pytest.mark.parametrize("skin", ALL.values(), ids=ALL)
@pytest.mark.parametrize("outputs", ["pixels", "units"])
def test_a_part_and_its_images_are_all_outputs(skin: Skin, outputs: Outputs) -> None:
    own = of_outputs(mirrors(skin), outputs)
    places, size = images.places(own), len(images.part(own))
    assert set(places.ravel()) == set(range(len(own) * size))
    sides = skin.grid.shape if outputs == "pixels" else skin.grid.units
    assert size == -(-own.shape[1] // len(own)) or any(side % 2 for side in sides)
    for mirror, permutation in enumerate(own):
        parts = torch.randn(len(own), 2, size)
        whole, mirrored = Parts(own)(parts), Parts(own)(shuffled(parts, mirror))
        torch.testing.assert_close(mirrored, whole[:, permutation])


@pytest.mark.parametrize(
    ("skin", "mirror"),
    [pytest.param(s, m, id=f"{name} {m}") for name, s in ALL.items() for m in range(len(mirrors(s)))],
)
@pytest.mark.parametrize("outputs", ["pixels", "units"])
def test_the_map_of_a_mirrored_sheet_is_the_mirrored_map(skin: Skin, mirror: int, outputs: Outputs) -> None:
    torch.manual_seed(3)
    model = VD2T(replace(SMALL, outputs=outputs), skin).eval()
    for module in model.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            module.running_mean.normal_(0.0, 0.3)
    dv, predicted, clouds = 0.1 * torch.randn(3, 104), 0.1 * torch.randn(3, 104), torch.randn(3, 3, *skin.grid.shape)
    image = mirrors(skin)[mirror]
    other_clouds = torch.from_numpy(image.clouds(clouds.numpy()))
    with torch.inference_mode():
        whole = model.logits(dv, model.bias(clouds), predicted)
        mirrored = model.logits(dv[:, image.rows], model.bias(other_clouds), predicted[:, image.rows])
    permutation = of_outputs([image], outputs)[0]
    assert whole.shape == (3, len(permutation))
    assert whole.std() > 0.05
    torch.testing.assert_close(mirrored, whole[:, permutation], atol=1e-5, rtol=0)


def test_what_has_no_symmetric_form_is_refused() -> None:
    with pytest.raises(ValueError, match="symmetric"):
        Architecture(symmetric=True, voltage_channel="paper", convolutions=(4, 4, 4))


@pytest.mark.parametrize("name", SKINS)
def test_a_recipe_fitted_to_fewer_images_reads_as_many_weights_of_the_same_sized_map(name: str) -> None:
    base, skin = recipe("free"), replace(SKINS[name], map=PAPER.map)
    made = fitted(base, skin)
    assert made.architecture.symmetric == (len(mirrors(skin)) > 1)
    weights = [VD2T(one.architecture, of).streamed_weights() for one, of in ((made, skin), (base, PAPER))]
    assert 0.93 < weights[0] / weights[1] < 1.07
    assert fitted(base, PAPER) == base
