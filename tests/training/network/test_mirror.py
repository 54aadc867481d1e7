import numpy as np
import pytest

from eitskin_proto.sensor.grid import UNIT_OF_PIXEL, pixel_centres_mm, unit_rect_mm
from eitskin_proto.skin.cloud import network_input
from eitskin_sim.fem import forward, meshing
from eitskin_sim.scene import bend
from eitskin_sim.scene.parts import Bend, Electrodes, Sheet
from eitskin_training.network.mirror import MIRRORS, Mirror

SHEET = Sheet()
BENT = Bend(angle_deg=70.0, axis_deg=20.0, skew=0.4, twist_deg=10.0, stretch_along=1.1, nonuniformity=0.05)
MIRRORED = [mirror for mirror in MIRRORS if mirror.x or mirror.y]


def mirrored(xy: np.ndarray, mirror: Mirror) -> np.ndarray:
    flip = np.array([mirror.x, mirror.y])
    return np.where(flip, np.array([150.0, 100.0]) - xy, xy)


def voltages(mirror: Mirror, rect: tuple[float, float, float, float]) -> np.ndarray:
    """Return (104,) V of the mirror image of a touched, bent sheet."""
    corners = np.sort(mirrored(np.array(rect).reshape(2, 2), mirror), axis=0)
    x_lines, y_lines = meshing.electrode_lines(SHEET, Electrodes())
    (x0, y0), (x1, y1) = corners
    mesh = meshing.TensorMesh(
        meshing.graded_lines([*x_lines, (x0, 3.0), (x1, 3.0)], 8.0, 0.6),
        meshing.graded_lines([*y_lines, (y0, 3.0), (y1, 3.0)], 8.0, 0.6),
    )

    def metric(xy: np.ndarray) -> np.ndarray:
        sign = -1.0 if mirror.x != mirror.y else 1.0
        return bend.metric(BENT, SHEET, mirrored(xy, mirror)) * [1.0, sign, 1.0]

    centre = mesh.centres_mm
    inside = (centre[:, 0] > x0) & (centre[:, 0] < x1) & (centre[:, 1] > y0) & (centre[:, 1] < y1)
    system = forward.assemble(mesh, SHEET, Electrodes(), metric)
    return system.factorise(np.where(inside, 50.0, 1.0)).voltages()


@pytest.mark.parametrize("mirror", MIRRORED, ids=lambda m: f"x={m.x} y={m.y}")
def test_the_forward_model_agrees_with_the_permutation_of_rows(mirror: Mirror) -> None:
    rect = (23.0, 61.0, 37.0, 75.0)
    original, image = voltages(MIRRORS[0], rect), voltages(mirror, rect)
    # The mesh is mirrored too, so only rounding differs; a wrong permutation differs by the size of the voltages.
    np.testing.assert_allclose(image, original[mirror.rows], rtol=1e-6)
    assert np.abs(image / original - 1.0).max() > 0.1


@pytest.mark.parametrize("mirror", MIRRORED, ids=lambda m: f"x={m.x} y={m.y}")
def test_a_mirrored_cloud_is_the_cloud_of_the_mirrored_sheet(mirror: Mirror) -> None:
    centres = pixel_centres_mm().reshape(-1, 2)
    original = bend.surface(BENT, SHEET, centres).T.reshape(3, 30, 45)
    image = bend.surface(BENT, SHEET, mirrored(centres, mirror)).T.reshape(3, 30, 45)
    image = image * np.array([-1.0 if mirror.x else 1.0, -1.0 if mirror.y else 1.0, 1.0])[:, None, None]
    found = mirror.clouds(network_input(original)[None])[0]
    np.testing.assert_allclose(found, network_input(image), atol=1e-5)


@pytest.mark.parametrize("mirror", MIRRORS, ids=lambda m: f"x={m.x} y={m.y}")
def test_a_mirror_undoes_itself(mirror: Mirror) -> None:
    for permutation in (mirror.rows, mirror.pixels, mirror.units):
        np.testing.assert_array_equal(permutation[permutation], np.arange(len(permutation)))


@pytest.mark.parametrize("mirror", MIRRORED, ids=lambda m: f"x={m.x} y={m.y}")
def test_pixels_and_units_go_where_their_places_go(mirror: Mirror) -> None:
    centres = pixel_centres_mm().reshape(-1, 2)
    np.testing.assert_allclose(centres[mirror.pixels], mirrored(centres, mirror), atol=1e-9)
    rects = np.array([unit_rect_mm(unit % 14, unit // 14) for unit in range(126)]).reshape(126, 2, 2)
    middles = rects.mean(axis=1)
    np.testing.assert_allclose(middles[mirror.units], mirrored(middles, mirror), atol=1e-9)
    # One column of pixels lies on a border between units, so hard labels are mirrored as units, never as pixels.
    moved = UNIT_OF_PIXEL.reshape(-1)[mirror.pixels] != mirror.units[UNIT_OF_PIXEL.reshape(-1)]
    assert moved.sum() == (30 if mirror.x else 0)
