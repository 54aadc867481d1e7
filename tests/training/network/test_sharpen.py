"""Sharpening: nothing at first, the same everywhere, and no further than its blocks reach."""

import numpy as np
import pytest
import torch
from torch import nn

from eitskin_proto.sensor.grid import GRID_SHAPE, N_PIXELS
from eitskin_training.network.sharpen import CELL, CELLS, PIXEL_OF_CELL, Sharpen


def trained_looking(channels: tuple[int, ...] = (8, 8)) -> Sharpen:
    torch.manual_seed(0)
    sharpen = Sharpen(channels, nn.SiLU)
    for block in sharpen.blocks:
        nn.init.normal_(block[-1].weight, std=0.5)
    return sharpen.eval()


@torch.inference_mode()
def test_it_begins_as_the_identity_and_without_blocks_stays_it() -> None:
    logits = torch.randn(3, N_PIXELS, generator=torch.Generator().manual_seed(1))
    for channels in ((), (8, 8)):
        torch.testing.assert_close(Sharpen(channels, nn.SiLU)(logits), logits, rtol=0, atol=0)
    assert not torch.allclose(trained_looking()(logits), logits, atol=0.1)


@pytest.mark.parametrize("channels", [(8,), (8, 8)])
@torch.inference_mode()
def test_a_pixel_is_seen_one_cell_further_with_every_block(channels: tuple[int, ...]) -> None:
    sharpen = trained_looking(channels)
    logits = torch.zeros(1, N_PIXELS)
    changed = logits.clone()
    changed[0, 13 * GRID_SHAPE[1] + 22] = 3.0  # cell (4, 7)
    difference = (sharpen(changed) - sharpen(logits)).view(GRID_SHAPE).abs().numpy()
    by_cell = difference.reshape(CELLS[0], CELL, CELLS[1], CELL).max(axis=(1, 3)) > 0
    rows, columns = np.nonzero(by_cell)
    assert (rows.min(), rows.max()) == (4 - len(channels), 4 + len(channels))
    assert (columns.min(), columns.max()) == (7 - len(channels), 7 + len(channels))


@torch.inference_mode()
def test_it_is_the_same_everywhere_inside() -> None:
    sharpen = trained_looking()
    grid = torch.zeros(1, 1, *GRID_SHAPE)
    grid[..., 9:12, 12:15] = torch.randn(3, 3, generator=torch.Generator().manual_seed(2))
    moved = grid.roll((2 * CELL, 3 * CELL), dims=(2, 3))
    found = sharpen(grid.flatten(1)).view(GRID_SHAPE).roll((2 * CELL, 3 * CELL), dims=(0, 1))
    expected = sharpen(moved.flatten(1)).view(GRID_SHAPE)
    inside = (slice(3 * CELL, -CELL), slice(4 * CELL, -CELL))
    # the background is sharpened too, and differently at the border, where cells are missing: compare away from it
    torch.testing.assert_close(found[inside][2 * CELL :, 2 * CELL :], expected[inside][2 * CELL :, 2 * CELL :])


def test_the_order_of_cells_takes_nine_pixels_after_another() -> None:
    order = np.arange(N_PIXELS).reshape(GRID_SHAPE)
    for cell, (row, column) in ((0, (0, 0)), (14, (0, 14)), (15, (1, 0)), (149, (9, 14))):
        own = order[CELL * row : CELL * (row + 1), CELL * column : CELL * (column + 1)]
        assert PIXEL_OF_CELL[9 * cell : 9 * (cell + 1)].tolist() == own.ravel().tolist()
