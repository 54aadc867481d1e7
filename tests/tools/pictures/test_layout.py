"""Maps on screens of any size: both are shown wherever they fit, nothing is cut without a word, nothing wraps."""

import io
import re

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_tools.pictures import Painter

TITLE = "eitskin demo    12.3 s   the sheet is bent by 156 deg, its axis at +30, stretched 13.1 %; 3 touches"
FOOTER = [
    "frame 123456, touched, by vd2t-int8, skipped geometry:cloud_unchanged, map:unchanged, cloud 12",
    "last byte to here 0.52 ms   lost 0   corrupt 0   12 s   Ctrl-C ends",
]


def a_map():
    image = np.zeros(PAPER.grid.shape)
    image[3:7, 10:15] = 1.0
    return image


def drawn(width, height):
    lines = Painter(io.StringIO()).picture(width, height, TITLE, a_map(), 1.0 - a_map(), FOOTER)
    return [re.sub("\x1b\\[[0-9;]*m", "", line) for line in lines]


@pytest.mark.parametrize("size", [(80, 24), (94, 21), (200, 50), (60, 40), (100, 30), (300, 100)])
def test_both_maps_and_every_word_are_shown(size, monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    lines = drawn(*size)
    assert len(lines) <= size[1]
    assert max(map(len, lines)) <= size[0]
    text = " ".join(" ".join(lines).split())
    for said in (*TITLE.split(), *FOOTER[0].split(), *FOOTER[1].split(), "streamed", "truth"):
        assert said in text
