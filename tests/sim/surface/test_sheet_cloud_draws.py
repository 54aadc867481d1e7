"""Clouds of drawn deformations pass without a word; the same ones, wrongly made, never do."""

import numpy as np
import pytest

from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_sim.scene.family import draw, paper_bends
from eitskin_sim.surface.measured_cloud import measured_cloud


@pytest.fixture(scope="module")
def bends():
    return (*paper_bends(10), *draw("A", 12, 20261), *draw("B", 12, 20261))


@pytest.fixture(scope="module")
def clouds(bends):
    rng = np.random.default_rng(8)
    return [measured_cloud(bend, rng).astype(np.float64) for bend in bends]


@pytest.mark.slow
def test_every_drawn_cloud_passes_without_a_word(clouds):
    assert [doubts for cloud in clouds for doubts in check_sheet(cloud)[1]] == []


def test_scans_without_noise_pass_as_well(bends):
    assert {check_sheet(measured_cloud(bend))[1] for bend in bends[::10]} == {()}


RNG = np.random.default_rng(4)

WRONG = {
    "double size": lambda cloud: 2.0 * cloud,
    "half as large again": lambda cloud: 1.5 * (cloud - cloud.mean(axis=(1, 2), keepdims=True)),
    "half size": lambda cloud: 0.5 * cloud,
    "noise of 0.6 mm": lambda cloud: cloud + 0.6 * RNG.standard_normal(cloud.shape),
    "x along the rows": lambda cloud: cloud.swapaxes(1, 2)[:, np.arange(30) * 45 // 30][:, :, np.arange(45) * 30 // 45],
    "read column by column": lambda cloud: cloud.swapaxes(1, 2).reshape(3, 30, 45),
    "read by another order of axes": lambda cloud: np.moveaxis(cloud, 0, -1).reshape(3, 30, 45),
    "rows in any order": lambda cloud: cloud[:, RNG.permutation(30)],
    "a column missing": lambda cloud: cloud[:, :, [*range(20), *range(21, 45), 44]],
}


@pytest.mark.parametrize("name", WRONG)
def test_every_wrongly_made_cloud_is_refused(clouds, name):
    for cloud in clouds:
        with pytest.raises(ValueError, match="expected"):
            check_sheet(WRONG[name](cloud))


@pytest.mark.parametrize(
    "mirror", [lambda cloud: cloud[:, ::-1], lambda cloud: cloud[:, :, ::-1], lambda cloud: cloud[[1, 0, 2]]]
)
def test_every_cloud_mirrored_is_warned_of_where_the_sheet_is_bent_by_80_degrees(bends, clouds, mirror):
    bent = [cloud for bend, cloud in zip(bends, clouds, strict=True) if bend.angle_deg > 80.0]
    assert len(bent) > 8
    assert all(check_sheet(mirror(cloud))[1] for cloud in bent)
