import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.table import RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem import forward
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.scene import parse_scene
from eitskin_tools.cli import main

pytestmark = pytest.mark.heavy


def write(path: Path, scene: object) -> str:
    path.write_text(json.dumps(scene))
    return str(path)


def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], scene: object, *words: str) -> str:
    """Return the one line that a scene is refused with; nothing is written."""
    out = tmp_path / "V.npz"
    assert main(["simulate", write(tmp_path / "scene.json", scene), "--out", str(out), *words]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["scene.json"]
    return error


def test_simulate_writes_voltages_with_their_scene_and_ids(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    described = {"touches": [{"disc_mm": [60, 40, 8]}], "current_A": 0.5, "element_size_mm": 3}
    scene, out = write(tmp_path / "scene.json", described), tmp_path / "V.npz"
    assert main(["simulate", scene, "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    with np.load(out) as file:
        voltages, full = file["voltages"], file["voltages208"]
        assert (voltages.dtype, voltages.shape, full.shape) == (np.float64, (104,), (208,))
        assert (str(file["protocol_id"]), str(file["grid_id"])) == (PROTOCOL_ID, PAPER.grid_id)
        assert parse_scene(json.loads(str(file["scene"]))) == parse_scene(described)
    np.testing.assert_array_equal(voltages, full[ROW_IN_FULL])
    np.testing.assert_allclose(voltages, full[RECIPROCAL_IN_FULL], rtol=1e-12)
    assert report["largest_V"] == pytest.approx(np.abs(voltages).max())


def test_simulate_gives_a_device_and_its_reference(tmp_path: Path) -> None:
    layer = {"gauge_factor": 1, "field": {"rms": 0.05, "correlation_mm": 40, "seed": 3}}
    electrodes = {"size_mm": [4 + 0.1 * (k % 2) for k in range(16)], "contact_impedance_ohm_m2": [2e-4] * 16}
    device: dict[str, Any] = {"sheet": layer, "electrodes": electrodes, "element_size_mm": 6}
    late = {**device, "sheet": {**layer, "late": {"factor": 1.25}}, "bend": {"stretch_along": 1.1}}
    scene, rows = write(tmp_path / "scene.json", late), {}
    for name, options in (("bent", []), ("reference", ["--reference"])):
        out = tmp_path / f"{name}.npz"
        assert main(["simulate", scene, "--out", str(out), *options]) == 0
        with np.load(out) as file:
            rows[name], kept = file["voltages"], parse_scene(json.loads(str(file["scene"])))
    assert kept == parse_scene(device)
    np.testing.assert_array_equal(rows["reference"], solve_scene(parse_scene(device), "modes").voltages)
    np.testing.assert_array_equal(rows["bent"], solve_scene(parse_scene(late), "modes").voltages)
    assert np.abs(rows["bent"] / rows["reference"] - 1.0).max() > 0.1


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        ({"touches": [{"rect_mm": [0, 0, 200, 10]}]}, "outside the sheet: x = 200 mm; it must be from 0 to 150"),
        ({"electrodes": {"size_mm": 40}}, "must be at least 40 mm"),
        ({"sheet": {"conductivity_S_per_m": -1}}, "conductivity_S_per_m is -1, expected a number from 1e-06 to 1e+08"),
        ({"bend": {"angle_deg": 370}}, "folds the sheet"),
        ({"touches": [{"disc_mm": [50, 50, 0.4]}]}, "smaller than an element"),
    ],
)
def test_bad_scene_is_one_line_exit_one_and_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scene: object, says: str
) -> None:
    assert says in refused(tmp_path, capsys, scene)


class Useless:
    """A factorisation that came to an end, and to nothing."""

    def solve(self, currents: np.ndarray) -> np.ndarray:
        return np.full_like(currents, np.nan)


def singular(error: Exception) -> Callable[..., Useless]:
    def factorise(*_: object, **__: object) -> Useless:
        raise error

    return factorise


@pytest.mark.parametrize(
    ("found", "says"),
    [
        (singular(RuntimeError("Factor is exactly singular")), "Factor is exactly singular; conductivities"),
        (singular(np.linalg.LinAlgError("Singular matrix")), "Singular matrix; conductivities"),
        (lambda *_, **__: Useless(), "its voltages are not finite; conductivities"),
    ],
    ids=["no factor", "no inverse", "no number"],
)
def test_a_scene_that_cannot_be_solved_is_one_line_exit_one_and_no_file(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    found: Callable[..., Useless],
    says: str,
) -> None:
    monkeypatch.setattr(forward, "splu", found)  # what a matrix does to it depends on the library's release
    said = refused(tmp_path, capsys, {"element_size_mm": 10})
    assert f"eitskin simulate: the scene cannot be solved: {says}" in said
