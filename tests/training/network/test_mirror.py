import numpy as np
import pytest
from tests.training.network.skins import ALL, built

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.cloud import network_input
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem import forward, meshing
from eitskin_sim.scene import bend
from eitskin_sim.scene.parts import Bend
from eitskin_training.network.mirror import Mirror, mirrors

BENT = Bend(angle_deg=70.0, axis_deg=20.0, skew=0.4, twist_deg=10.0, stretch_along=1.1, nonuniformity=0.05)
CASES = [
    pytest.param(skin, mirror, id=f"{name}: x={mirror.x} y={mirror.y}")
    for name, skin in ALL.items()
    for mirror in mirrors(skin)[1:]
]
IMAGES = {"paper": 4, "four, odd rows and columns": 4, "x": 2, "y": 2, "both at once": 2, "none": 1}


def mirrored(xy: np.ndarray, mirror: Mirror, skin: Skin) -> np.ndarray:
    flip = np.array([mirror.x, mirror.y])
    return np.where(flip, np.array(skin.outline.size_mm) - xy, xy)


def voltages(skin: Skin, mirror: Mirror, rect: tuple[float, float, float, float]) -> np.ndarray:
    """Return (104,) V of the mirror image of a touched, bent sheet."""
    sheet, electrodes = built(skin)
    corners = np.sort(mirrored(np.array(rect).reshape(2, 2), mirror, skin), axis=0)
    x_lines, y_lines = meshing.electrode_lines(sheet, electrodes)
    (x0, y0), (x1, y1) = corners
    mesh = meshing.TensorMesh(
        meshing.graded_lines([*x_lines, (x0, 6.0), (x1, 6.0)], 16.0, 0.6),
        meshing.graded_lines([*y_lines, (y0, 6.0), (y1, 6.0)], 16.0, 0.6),
    )

    def metric(xy: np.ndarray) -> np.ndarray:
        sign = -1.0 if mirror.x != mirror.y else 1.0
        return bend.metric(BENT, sheet, mirrored(xy, mirror, skin)) * [1.0, sign, 1.0]

    centre = mesh.centres_mm
    inside = (centre[:, 0] > x0) & (centre[:, 0] < x1) & (centre[:, 1] > y0) & (centre[:, 1] < y1)
    system = forward.assemble(mesh, sheet, electrodes, metric)
    return system.factorise(np.where(inside, 50.0, 1.0)).voltages()


@pytest.mark.parametrize(("name", "count"), IMAGES.items())
def test_a_skin_has_the_images_that_its_electrodes_allow(name: str, count: int) -> None:
    assert len(mirrors(ALL[name])) == count
    assert not mirrors(ALL[name])[0].x | mirrors(ALL[name])[0].y


def test_the_papers_electrodes_go_where_they_always_went() -> None:
    pair = np.arange(16)
    row_of = {tuple(row): number for number, row in enumerate(TABLE.tolist())}
    for mirror in mirrors(PAPER):
        image = (3 - pair) % 16 if mirror.x else pair
        image = (11 - image) % 16 if mirror.y else image
        expected = [row_of[tuple(sorted(image[row].tolist()))] for row in TABLE.astype(int)]
        assert mirror.rows.tolist() == expected


@pytest.mark.parametrize(("skin", "mirror"), CASES[2::3])
def test_the_forward_model_agrees_with_the_permutation_of_rows(skin: Skin, mirror: Mirror) -> None:
    rect = (23.0, 41.0, 37.0, 55.0)
    original, image = voltages(skin, mirrors(skin)[0], rect), voltages(skin, mirror, rect)
    # The mesh is mirrored too, so only rounding differs; a wrong permutation differs by the size of the voltages.
    np.testing.assert_allclose(image, original[mirror.rows], rtol=1e-6)
    assert np.abs(image / original - 1.0).max() > 0.05


@pytest.mark.parametrize(("skin", "mirror"), CASES)
def test_a_mirrored_cloud_is_the_cloud_of_the_mirrored_sheet(skin: Skin, mirror: Mirror) -> None:
    sheet, _ = built(skin)
    centres, shape = skin.grid.pixel_centres_mm().reshape(-1, 2), (3, *skin.grid.shape)
    original = bend.surface(BENT, sheet, centres).T.reshape(shape)
    image = bend.surface(BENT, sheet, mirrored(centres, mirror, skin)).T.reshape(shape)
    image = image * np.array([-1.0 if mirror.x else 1.0, -1.0 if mirror.y else 1.0, 1.0])[:, None, None]
    found = mirror.clouds(network_input(original, skin.grid)[None])[0]
    np.testing.assert_allclose(found, network_input(image, skin.grid), atol=1e-5)


@pytest.mark.parametrize(("skin", "mirror"), CASES)
def test_pixels_and_units_go_where_their_places_go(skin: Skin, mirror: Mirror) -> None:
    grid = skin.grid
    centres = grid.pixel_centres_mm().reshape(-1, 2)
    np.testing.assert_allclose(centres[mirror.pixels], mirrored(centres, mirror, skin), atol=1e-9)
    rows, columns = np.divmod(np.arange(grid.n_units), grid.units[1])
    corners = [grid.unit_rect_mm(int(column), int(row)) for row, column in zip(rows, columns, strict=True)]
    middles = np.array(corners).reshape(-1, 2, 2).mean(axis=1)
    np.testing.assert_allclose(middles[mirror.units], mirrored(middles, mirror, skin), atol=1e-9)
