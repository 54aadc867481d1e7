"""A symmetric network: what it makes of a mirror image is the image of what it makes."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from eitskin_proto.sensor.grid import QUARTER_SHAPE
from eitskin_training.ablations import VARIANTS, variant_recipe
from eitskin_training.network import images
from eitskin_training.network.architecture import Architecture
from eitskin_training.network.images import IMAGES, ImageLinear, ImageNorm, Quarters
from eitskin_training.network.mirror import MIRRORS
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import recipe

SMALL = Architecture(
    widths=(24, 24), cloud_channels=(4, 4), hidden=20, log_predicted=True, activation="silu", symmetric=True
)


def shuffled(x: torch.Tensor, mirror: int) -> torch.Tensor:
    """The images of a mirrored sheet: image g of the one is image g-then-mirror of the other."""
    return x[[image ^ mirror for image in range(IMAGES)]]


@pytest.mark.parametrize("mirror", range(IMAGES))
def test_a_layer_commutes_with_mirrors_and_is_no_multiple_of_one(mirror: int) -> None:
    torch.manual_seed(1)
    layer, x = ImageLinear(6, 5, bias=True).double(), torch.randn(IMAGES, 3, 6, dtype=torch.float64)
    layer.signs = layer.signs.double()
    torch.testing.assert_close(layer(shuffled(x, mirror)), shuffled(layer(x), mirror))
    alone = layer(x * (torch.arange(IMAGES) == 0)[:, None, None])
    assert all(alone[image].std() > 0 for image in range(IMAGES))  # every image reads every other


def test_a_layer_keeps_sums_and_differences_apart() -> None:
    torch.manual_seed(2)
    layer = ImageLinear(4, 4)
    for k, signs in enumerate(images.SIGNS):
        x = torch.tensor(signs)[:, None, None] * torch.randn(1, 2, 4)
        y = layer(x)
        torch.testing.assert_close(y, torch.tensor(signs)[:, None, None] * y[:1])
        torch.testing.assert_close(y[0], x[0] @ layer.weight[k])


def test_a_norm_has_one_mean_for_all_images() -> None:
    norm, x = ImageNorm(3).train(), torch.randn(IMAGES, 50, 3) + torch.arange(4.0)[:, None, None]
    y = norm(x)
    torch.testing.assert_close(y.mean(dim=(0, 1)), torch.zeros(3), atol=1e-5, rtol=0)
    assert y[3].mean() > y[0].mean() + 1.0


def test_a_quarter_and_its_images_fill_the_map() -> None:
    one, other = images.places()
    size = QUARTER_SHAPE[0] * QUARTER_SHAPE[1]
    assert set(one) | set(other) == set(range(IMAGES * size))
    middle = np.flatnonzero(one != other)
    assert set(middle % 45) == {22}
    for mirror, permutation in enumerate(MIRRORS):
        quarters = torch.randn(IMAGES, 2, size)
        whole, mirrored = Quarters()(quarters), Quarters()(shuffled(quarters, mirror))
        torch.testing.assert_close(mirrored, whole[:, permutation.pixels])


@pytest.mark.parametrize("mirror", range(IMAGES))
def test_the_map_of_a_mirrored_sheet_is_the_mirrored_map(mirror: int) -> None:
    torch.manual_seed(3)
    model = VD2T(SMALL).eval()
    for module in model.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            module.running_mean.normal_(0.0, 0.3)
    dv, predicted, clouds = 0.1 * torch.randn(3, 104), 0.1 * torch.randn(3, 104), torch.randn(3, 3, 30, 45)
    image = MIRRORS[mirror]
    other_clouds = torch.from_numpy(image.clouds(clouds.numpy()))
    with torch.inference_mode():
        whole = model.logits(dv, model.bias(clouds), predicted)
        mirrored = model.logits(dv[:, image.rows], model.bias(other_clouds), predicted[:, image.rows])
    assert whole.std() > 0.1
    torch.testing.assert_close(mirrored, whole[:, image.pixels], atol=1e-5, rtol=0)


def test_symmetry_buys_width_at_as_many_weights_a_frame() -> None:
    base = recipe("free")
    assert "unmirrored" in VARIANTS
    plain, symmetric = (VD2T(variant_recipe(base, name).architecture) for name in ("unmirrored", "both"))
    assert symmetric.streamed_weights() < 1.02 * plain.streamed_weights()
    assert symmetric.architecture.bias_width > 2 * plain.architecture.bias_width


def test_what_has_no_symmetric_form_is_refused() -> None:
    for changes in ({"outputs": 126}, {"voltage_channel": "paper", "convolutions": (4, 4, 4)}):
        wrong: dict[str, Any] = {"symmetric": True, **changes}
        with pytest.raises(ValueError, match="symmetric"):
            Architecture(**wrong)
