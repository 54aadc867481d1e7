"""Maps on screens of any size: both are shown wherever they fit, and no line wraps."""

import io
import re

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_tools.pictures import HALF, Painter


@pytest.mark.parametrize("size", [(80, 24), (94, 21), (200, 50), (60, 40), (300, 100)])
def test_both_maps_are_shown_beside_each_other(size):
    image = np.zeros(PAPER.grid.shape)
    image[3:7, 10:15] = 1.0
    title, captions, *maps = Painter(io.StringIO()).picture(*size, "the title " * 20, image, 1.0 - image)
    assert title == ("the title " * 20)[: size[0]]
    assert re.fullmatch(r"streamed +truth", captions)
    assert len(maps) <= size[1] - 2
    for line in maps:
        left, right = re.sub("\x1b\\[[0-9;]*m", "", line).split("    ")
        assert left == right == HALF * len(left)
        assert len(line) > 2 * len(left) + 4 <= size[0]
