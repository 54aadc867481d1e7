import numpy as np
import pytest
import torch
from tests.second_skin import SECOND

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_training.network.architecture import Architecture
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import RECIPES, Recipe, recipe


def inputs(count: int = 8) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return 0.1 * torch.randn(count, N_ROWS, generator=generator), torch.randn(count, 3, 30, 45, generator=generator)


@pytest.mark.parametrize("name", RECIPES)
def test_every_recipe_stays_within_the_weights_that_a_frame_may_stream(name: str) -> None:
    model = VD2T(recipe(name).architecture, PAPER)
    assert model.parameter_count() <= 2_500_000
    assert model.streamed_weights() <= 1_510_000  # about 1.5 million: what a frame's bytes cost is in `bench frame`


@pytest.mark.parametrize("name", RECIPES)
def test_the_two_halves_equal_the_whole_network(name: str) -> None:
    torch.manual_seed(0)
    model = VD2T(recipe(name).architecture, PAPER).eval()
    dv, clouds = inputs()
    with torch.inference_mode():
        whole = model(dv, clouds)
        halves = model.logits(dv, model.bias(clouds))
    torch.testing.assert_close(halves, whole, rtol=0, atol=1e-6)


def test_the_cloud_changes_the_map_unless_it_is_left_out() -> None:
    dv, clouds = inputs()
    for use_cloud in (True, False):
        torch.manual_seed(0)
        model = VD2T(Architecture(widths=(32, 32), hidden=32, use_cloud=use_cloud), PAPER).eval()
        with torch.inference_mode():
            assert torch.equal(model(dv, clouds), model(dv, clouds.flip(0))) is not use_cloud


@pytest.mark.parametrize("skin", [PAPER, SECOND], ids=lambda skin: skin.name)
def test_unit_outputs_are_spread_over_their_pixels(skin: Skin) -> None:
    model = VD2T(Architecture(widths=(16, 16), hidden=16, outputs="units"), skin)
    logits = torch.linspace(-3, 3, skin.grid.n_units)[None]
    expected = skin.grid.map_from_units(torch.sigmoid(logits).numpy()).reshape(1, -1)
    np.testing.assert_allclose(model.maps(logits).numpy(), expected, atol=1e-7)


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_survives_being_written_as_plain_values(name: str) -> None:
    plain = recipe(name).as_dict()
    assert Recipe.from_dict(plain) == recipe(name)
    older = {"pixels": 1350, "units": 126}[plain["architecture"]["outputs"]]
    assert Recipe.from_dict({**plain, "architecture": {**plain["architecture"], "outputs": older}}) == recipe(name)


def test_an_unknown_recipe_or_shape_is_refused_with_what_was_expected() -> None:
    with pytest.raises(ValueError, match="expected one of paper"):
        recipe("papre")
    with pytest.raises(ValueError, match="outputs is 100; expected one of pixels, units"):
        Architecture(outputs=100)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="train again"):
        Recipe.from_dict({"name": "x"})
