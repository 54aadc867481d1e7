"""Teaching, on a sheet with a known answer: rows see smooth bumps, readings drift, presses differ in strength."""

import json
import re

import numpy as np
import pytest

from eitskin.model.bundle import load_bundle
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.cli import main
from eitskin_tools.teach.presses import PressesError, load_presses
from eitskin_tools.teach.response import learn
from eitskin_tools.teach.teaching import teach

ROWS, SIZE_MM = 60, (140.0, 90.0)
SEEN_MM = np.random.default_rng(3).uniform((0, 0), SIZE_MM, (ROWS, 2))
LEVEL_V = np.random.default_rng(4).uniform(-2.0, 2.0, ROWS)


NOISE = 3e-3 * np.random.default_rng(6).normal(size=(40, ROWS))


def responses(places_mm):
    distance = ((np.asarray(places_mm)[:, None] - SEEN_MM) ** 2).sum(axis=-1)
    return 0.02 * np.exp(-distance / (2.0 * 22.0**2))


def recorded(count, seed=0, noise=3e-3):
    """Return the arrays of a file: readings in turn untouched and pressed, on a sheet that drifts by 20 %."""
    rng = np.random.default_rng(seed)
    xy = np.full((2 * count, 2), np.nan)
    xy[1::2] = rng.uniform((10, 10), (130, 80), (count, 2))
    logs = noise * rng.normal(size=(2 * count, ROWS)) + np.linspace(0.0, 0.2, 2 * count)[:, None]
    logs[1::2] += rng.uniform(0.6, 1.4, (count, 1)) * responses(xy[1::2])
    return {"voltages_V": LEVEL_V * np.exp(logs), "xy_mm": xy, "size_mm": np.array(SIZE_MM), "outline": "rectangle"}


def write(path, arrays):
    np.savez(path, **arrays)
    return str(path)


@pytest.fixture(scope="module")
def taught(tmp_path_factory):
    folder = tmp_path_factory.mktemp("teach")
    file = write(folder / "presses.npz", recorded(100))
    out = str(folder / "mine.eitskin")
    assert main(["teach", file, "--out", out, "--picture", str(folder / "weak.png")]) == 0
    return folder, out


def test_presses_that_were_not_taught_are_placed_and_their_errors_hold(taught, capsys):
    folder, out = taught
    assert (folder / "weak.png").stat().st_size > 1000
    other = write(folder / "other.npz", recorded(150, seed=1))
    assert main(["evaluate", "--measured", other, "--bundle", out, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["presses"] == 150
    assert found["localisation_median_mm"] < 5.5  # 3.2 where the field itself is known
    assert 0.55 < found["stated_within_1sd"] < 0.8
    assert found["missed"] < 0.05
    assert found["false_touches"] < 0.05  # 1 % of 149 in the mean
    assert found["gate_auc"] > 0.98
    against = found["against"]
    assert against["the first untouched reading"]["localisation_median_mm"] > 10.0  # drift is ten times the signal
    assert main(["evaluate", "--measured", other, "--bundle", out]) == 0
    assert "the last untouched reading" in capsys.readouterr().out


def test_the_bundle_states_its_rows_and_its_accuracy(taught):
    bundle = load_bundle(taught[1])
    assert bundle.rows == ROWS
    assert bundle.skin.outline.size_mm == SIZE_MM
    card = bundle.manifest["metrics"]["taught"]
    assert card["presses"] == 100
    few, half, whole = card["presses_and_median_mm"].values()
    assert few > half > whole > 1.0


def test_physics_counts_where_it_holds_and_falls_away_where_it_does_not():
    rng = np.random.default_rng(2)
    places, others = rng.uniform((10, 10), (130, 80), (2, 14, 2))
    changes = -responses(places) + 3e-3 * rng.normal(size=(14, ROWS))
    right = learn(changes, places, SIZE_MM, responses(places))
    wrong = learn(changes, places, SIZE_MM, responses(places[:, ::-1] * [1.55, 0.64]))
    alone = learn(changes, places, SIZE_MM)
    assert right.prior_weight == pytest.approx(-1.0, abs=0.15)
    assert wrong.prior_weight == 0.0

    def error(found, prior=None):
        field, truth = found.at(others, prior)[0], -responses(others) @ found.project
        return np.linalg.norm(field - truth) / np.linalg.norm(truth)

    assert error(right, responses(others)) < 0.3 * error(alone)


def test_changes_of_another_unit_are_evaluated_but_no_runtime_is_promised(tmp_path, capsys):
    arrays = recorded(60, noise=1e-3)
    pressed = np.log(arrays["voltages_V"][1::2] / arrays["voltages_V"][::2])
    changes = {"change": 1e4 * pressed, "xy_mm": arrays["xy_mm"][1::2], "size_mm": arrays["size_mm"]}
    file, out = write(tmp_path / "c.npz", changes), str(tmp_path / "c.eitskin")
    assert main(["teach", file, "--out", out]) == 0
    assert "evaluate --measured" in capsys.readouterr().out
    assert main(["evaluate", "--measured", file, "--bundle", out, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["localisation_median_mm"] < 2.0
    assert found["false_touches"] is None


def spoiled(**changed):
    return {key: value for key, value in {**recorded(20), **changed}.items() if value is not None}


def unfelt(count, seed):
    noise = 3e-3 * np.random.default_rng(seed + 100).normal(size=(2 * count, ROWS))
    return {**recorded(count, seed), "voltages_V": LEVEL_V * np.exp(noise)}


def xy_with(index, place):
    xy = recorded(20)["xy_mm"]
    xy[index] = place
    return xy


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        (recorded(5), "holds 5 presses, expected at least 6"),
        (spoiled(xy_mm=np.where(np.isnan(recorded(20)["xy_mm"]), np.nan, 40.0)), "expected places all over the sheet"),
        (spoiled(xy_mm=xy_with(3, (150.0, 20.0))), r"xy_mm\[3\] is .* off the rectangle"),
        (spoiled(xy_mm=xy_with(3, (np.nan, 20.0))), "expected two numbers, or twice NaN"),
        (spoiled(outline="disc", size_mm=np.array([140.0, 140.0]), xy_mm=xy_with(3, (5.0, 5.0))), "off the disc"),
        (spoiled(voltages_V=np.full((40, ROWS), np.nan)), "not finite|finite numbers"),
        (spoiled(table=np.array([[0, 1, 2, 3], [1, 2, 3, 7]])), "table has 2 rows, and voltages_V 60"),
        (spoiled(change=np.zeros((40, ROWS))), "expected voltages_V or change"),
        (spoiled(xy_mm=np.where(np.isnan(recorded(20)["xy_mm"]), 40.0, 50.0)), "no reading is untouched"),
        (spoiled(size_mm=np.array([14.0, 9.0])), "expected 50 to 400"),
        (spoiled(outline="oval"), "expected rectangle or disc"),
        (spoiled(voltages_V=np.abs(LEVEL_V) * np.ones((40, 1))), "not felt"),
        (spoiled(voltages_V=LEVEL_V * np.exp(NOISE)), "not felt"),
        (unfelt(10, seed=16), "not felt"),  # the places explain it better than 85 % of shuffled ones
    ],
)
def test_presses_that_cannot_be_taught_are_refused_in_a_line(tmp_path, capsys, arrays, said):
    file = write(tmp_path / "p.npz", arrays)
    assert main(["teach", file, "--out", str(tmp_path / "p.eitskin")]) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert not (tmp_path / "p.eitskin").exists()
    assert re.search(said, error), error


def test_another_sheet_or_other_rows_are_refused(taught, tmp_path, capsys):
    arrays = recorded(20)
    narrower = write(tmp_path / "n.npz", {**arrays, "voltages_V": arrays["voltages_V"][:, :50]})
    larger = write(tmp_path / "l.npz", {**arrays, "size_mm": np.array([200.0, 90.0])})
    for file, said in ((narrower, "rows-50"), (larger, "200")):
        assert main(["evaluate", "--measured", file, "--bundle", taught[1]]) == 1
        assert said in capsys.readouterr().err
    assert main(["evaluate", "--measured", narrower]) == 2
    assert "eitskin teach" in capsys.readouterr().err
    with pytest.raises(PressesError, match="name the skin"):
        teach(load_presses(narrower), PAPER, 0.01)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--places", "list.txt"], "--places does nothing without --recording"),
        (["--presses", "30"], "--presses does nothing without --port"),
        (["--recording", "a.mcap"], "--recording needs --places"),
        (["--port", "/dev/null", "--recording", "a.mcap", "--places", "list.txt"], "leave one out"),
        (["--port", "/dev/null", "--json"], "leave --json out"),
    ],
)
def test_options_that_contradict_each_other_are_refused(tmp_path, capsys, options, said):
    assert main(["teach", str(tmp_path / "p.npz"), "--out", str(tmp_path / "p.eitskin"), *options]) == 2
    assert said in capsys.readouterr().err
