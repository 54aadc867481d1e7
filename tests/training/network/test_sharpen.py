"""Sharpening: nothing at first, the same everywhere, and no further than its blocks reach."""

import numpy as np
import pytest
import torch
from torch import nn

from eitskin_training.network.sharpen import CELL_PIXELS, Sharpen, cells, pixel_of_cell

SHAPES = [(30, 45), (9, 60)]


def trained_looking(channels: tuple[int, ...] = (8, 8), shape: tuple[int, int] = SHAPES[0]) -> Sharpen:
    torch.manual_seed(0)
    sharpen = Sharpen(channels, nn.SiLU, shape)
    for block in sharpen.blocks:
        nn.init.normal_(block[-1].weight, std=0.5)
    return sharpen.eval()


@pytest.mark.parametrize("shape", SHAPES)
@torch.inference_mode()
def test_it_begins_as_the_identity_and_without_blocks_stays_it(shape: tuple[int, int]) -> None:
    logits = torch.randn(3, shape[0] * shape[1], generator=torch.Generator().manual_seed(1))
    for channels in ((), (8, 8)):
        torch.testing.assert_close(Sharpen(channels, nn.SiLU, shape)(logits), logits, rtol=0, atol=0)
    assert not torch.allclose(trained_looking(shape=shape)(logits), logits, atol=0.1)


@pytest.mark.parametrize("channels", [(8,), (8, 8)])
@torch.inference_mode()
def test_a_pixel_is_seen_one_cell_further_with_every_block(channels: tuple[int, ...]) -> None:
    shape = (30, 45)
    sharpen = trained_looking(channels, shape)
    logits = torch.zeros(1, 30 * 45)
    changed = logits.clone()
    changed[0, 13 * 45 + 22] = 3.0  # cell (4, 7)
    difference = (sharpen(changed) - sharpen(logits)).view(shape).abs().numpy()
    by_cell = difference.reshape(10, CELL_PIXELS, 15, CELL_PIXELS).max(axis=(1, 3)) > 0
    rows, columns = np.nonzero(by_cell)
    assert (rows.min(), rows.max()) == (4 - len(channels), 4 + len(channels))
    assert (columns.min(), columns.max()) == (7 - len(channels), 7 + len(channels))


@pytest.mark.parametrize("shape", SHAPES)
def test_the_order_of_cells_takes_nine_pixels_after_another(shape: tuple[int, int]) -> None:
    order, found = np.arange(shape[0] * shape[1]).reshape(shape), pixel_of_cell(shape)
    rows, columns = cells(shape)
    for row, column in ((0, 0), (0, columns - 1), (1, 0), (rows - 1, columns - 1)):
        cell = row * columns + column
        own = order[CELL_PIXELS * row : CELL_PIXELS * (row + 1), CELL_PIXELS * column : CELL_PIXELS * (column + 1)]
        assert found[9 * cell : 9 * (cell + 1)].tolist() == own.ravel().tolist()


def test_a_map_without_whole_cells_is_refused_with_the_next_that_has_them() -> None:
    with pytest.raises(ValueError, match=r"20 x 44 pixels .*\[map\] shape = \[21, 45\]"):
        Sharpen((8,), nn.SiLU, (20, 44))
    Sharpen((), nn.SiLU, (20, 44))
