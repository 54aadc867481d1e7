"""The sheet's border from raw points: as sharp as they allow, on regular grids too, and its doubt is told."""

import json
from functools import lru_cache

import numpy as np
import pytest

from eitskin_sim.scene import bend as bends
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.scene import Bend, Sheet
from eitskin_sim.surface.edge import fit_edge
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.ordered_cloud import DOUBTFUL_RMS, PointCloudError, organise
from eitskin_sim.surface.predict import predict
from eitskin_tools import cli

pytestmark = pytest.mark.slow

SHEET = Sheet()
FLAT = Bend()
UNSTRETCHED = Bend(angle_deg=90, axis_deg=10)
STRETCHED = Bend(angle_deg=120, axis_deg=20, stretch_along=1.1)

NO_RIM = (0.0, 0.0)
"""The scan shows the sheet alone, so what is longer is stretched."""


def in_a_pose(bend, xy, noise_mm, rng):
    """Points of flat places in a random pose, and the corner (0, 0) among them."""
    points = bends.surface(bend, SHEET, np.concatenate([[[0.0, 0.0]], xy]))
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    seen = points @ turn.T + rng.uniform(-300, 300, 3)
    return seen[1:] + noise_mm * rng.standard_normal(seen[1:].shape), tuple(seen[0] + 1.0)


def even_places(bend, spacing_mm, rng):
    """Random flat places, evenly dense on the bent surface."""
    xy = rng.uniform((0, 0), SHEET.size_mm, (int(60_000 / spacing_mm**2), 2))
    form = bends.metric(bend, SHEET, xy)
    area = np.sqrt(form[:, 0] * form[:, 2] - form[:, 1] ** 2)
    xy = xy[rng.random(len(xy)) * area.max() < area]
    return xy[: int(15_000 * area.mean() / spacing_mm**2)]


def off(result, bend):
    """Rms over the rows of what V_pred from points is off the exact cloud's."""
    return float(np.sqrt(np.mean(np.log(predict(result.cloud_mm) / exact(bend)) ** 2)))


@lru_cache
def exact(bend):
    """V_pred of the exact cloud."""
    return predict(measured_cloud(bend))


def median_off(spacing_mm, noise_mm, draws):
    found = []
    for number, bend in enumerate(draws):
        rng = np.random.default_rng(number)
        found.append(off(organise(*in_a_pose(bend, even_places(bend, spacing_mm, rng), noise_mm, rng)), bend))
    return float(np.median(found))


def grid(kind, spacing_mm, rng):
    """Flat places: rows on the border, middles of cells, or middles shaken by 0.4 spacings, clipped to the border."""
    number = [round(size / spacing_mm) for size in SHEET.size_mm]
    if kind in ("to the border", "shaken to the border"):
        axes = [np.linspace(0.0, size, n + 1) for size, n in zip(SHEET.size_mm, number, strict=True)]
    else:
        axes = [(np.arange(n) + 0.5) * size / n for size, n in zip(SHEET.size_mm, number, strict=True)]
    xy = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    if "shaken" in kind:
        xy += rng.uniform(-0.4 * spacing_mm, 0.4 * spacing_mm, xy.shape)
    return np.clip(xy, 0.0, SHEET.size_mm)


KINDS = ["to the border", "middles", "shaken to the border", "shaken middles"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bend", [FLAT, UNSTRETCHED, STRETCHED], ids=["flat", "unstretched", "stretched"])
def test_every_grid_from_half_to_three_millimetres_gives_the_sheets_size(kind, bend):
    for spacing in (0.5, 1.0, 2.0, 3.0):
        for noise in (0.0, 0.1):
            rng = np.random.default_rng(7)
            found = organise(*in_a_pose(bend, grid(kind, spacing, rng), noise, rng))
            true = np.array([150.0 * bend.stretch_along, 100.0 * bend.stretch_across])
            # No grid shows where between its last row and half a row beyond the border lies.
            assert np.abs(found.size_mm - true).max() < 0.25 + 0.6 * spacing, (spacing, noise)


def test_grid_of_a_stretched_sheet_says_how_unsure_its_border_is():
    rng = np.random.default_rng(7)
    sparse, dense = (
        organise(*in_a_pose(STRETCHED, grid("middles", spacing, rng), 0.1, rng), rim_mm=NO_RIM)
        for spacing in (2.0, 1.0)
    )
    assert sparse.outline_sigma_mm == pytest.approx(0.5, abs=0.1)
    assert sparse.prediction_rms > DOUBTFUL_RMS > dense.prediction_rms


@pytest.mark.slow
def test_prediction_from_points_is_as_good_over_many_draws():
    draws = (*draw("A", 27, 20262), *draw("B", 27, 20262))
    assert median_off(1.0, 0.1, draws) < 0.010
    assert median_off(2.0, 0.1, draws) < 0.019


def test_doubt_grows_with_spacing_and_noise_and_is_that_of_the_draws():
    bend = draw("A", 3, 5)[2]

    def doubt(spacing, noise):
        rng = np.random.default_rng(1)
        return organise(*in_a_pose(bend, even_places(bend, spacing, rng), noise, rng), rim_mm=NO_RIM).prediction_rms

    assert doubt(1.0, 0.1) == pytest.approx(0.0075, rel=0.3)
    assert doubt(0.7, 0.1) < doubt(1.0, 0.1) < doubt(1.0, 0.3) < DOUBTFUL_RMS < doubt(3.0, 0.3)


@pytest.mark.parametrize("density", [0.25, 1.0, 4.0])
@pytest.mark.parametrize("noise", [0.05, 0.3])
def test_an_edge_of_random_points_is_found_without_bias_within_its_doubt(density, noise):
    rng = np.random.default_rng(2)
    start = np.array([0.7, 0.0, 0.0, 0.0, 0.0, 0.0])
    errors, sigmas = [], []
    for _ in range(24):
        along, out = rng.uniform((0.0, -12.0), (100.0, 0.0), (rng.poisson(1200 * density), 2)).T
        edge = fit_edge(along, out + noise * rng.standard_normal(len(out)), (0.0, 100.0), start, noise)
        places = np.polynomial.polynomial.polyval(np.linspace(0.0, 1.0, 101), edge.coefficients)
        errors.append(places)
        sigmas.append(edge.sigma_mm)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert abs(float(np.mean(errors))) < 0.5 * rms
    assert 0.5 * np.mean(sigmas) < rms < 2.0 * np.mean(sigmas)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["a line", "lines", "a triangle", "a block"])
def test_points_that_carry_no_sheet_are_refused_in_words(name):
    rng = np.random.default_rng(0)
    places = rng.random((9_000, 2))
    points = {
        "a line": np.outer(np.linspace(0.0, 400.0, 5_000), [1.0, 0.0, 0.0]),
        "lines": np.stack(np.meshgrid(np.linspace(0, 150, 1000), np.arange(0, 101, 20.0), [0.0]), -1).reshape(-1, 3),
        "a triangle": np.insert(places[places.sum(axis=1) < 1.0] * [190.0, 140.0], 2, 0.0, axis=1),
        "a block": rng.uniform(0.0, 150.0, (9_000, 3)),
    }[name]
    with pytest.raises(PointCloudError, match=r"expected|do not show the sheet") as caught:
        organise(points)
    assert "ingular" not in str(caught.value)


@pytest.mark.parametrize(("spacing", "noise", "doubtful"), [(1.0, 0.1, False), (3.0, 0.3, True)])
def test_command_warns_where_the_prediction_is_likely_worse_than_none(tmp_path, capsys, spacing, noise, doubtful):
    rng = np.random.default_rng(3)
    points, corner = in_a_pose(STRETCHED, even_places(STRETCHED, spacing, rng), noise, rng)
    np.save(tmp_path / "points.npy", points)
    words = ["surface", str(tmp_path / "points.npy"), "--out", str(tmp_path / "cloud.npz"), "--predict", "--json"]
    words += ["--rim", "0"]
    assert cli.main([*words, "--corner", *(f"{value:.3f}" for value in corner)]) == 0
    output = capsys.readouterr()
    report = json.loads(output.out)
    assert (report["prediction_rms"] > DOUBTFUL_RMS) is doubtful
    assert ("it may make maps worse" in output.err) is doubtful
    assert 0.02 < report["outline_sigma_mm"] < 0.5
