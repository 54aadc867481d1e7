import json
from pathlib import Path

import numpy as np
import pytest

from eitskin_sim.evaluation.device_runs import Plan
from eitskin_tools.bench.tradeoff import of_devices
from eitskin_tools.cli import main

pytestmark = pytest.mark.heavy

PHANTOMS = [
    {
        "name": "one",
        "truth": "units",
        "scene": {
            "bend": {"angle_deg": 40.0},
            "touches": [{"units": [[4, 3], [5, 3]], "conductivity_S_per_m": 50}],
        },
    }
]


@pytest.mark.slow
def test_every_variant_has_an_error_and_a_time_and_the_front_is_not_beaten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, picture = tmp_path / "phantoms.json", tmp_path / "front.png"
    path.write_text(json.dumps(PHANTOMS))
    assert main(["bench", "tradeoff", "--phantoms", str(path), "--calls", "10", "--plot", str(picture), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    rows = found["rows"]
    names = [row["variant"] for row in rows]
    assert {"tikhonov", "sbl", "l1, 10 steps", "vd2t", "vd2t-int8", "verified"} <= set(names)
    assert all(0.0 <= row["error"] <= 2.0 and row["p50"] > 0.0 for row in rows)
    front = [row for row in rows if row["pareto"]]
    assert front
    for one in front:
        assert not any(other["error"] < one["error"] and other["p50"] < one["p50"] for other in rows)
    assert picture.stat().st_size > 10_000


def test_phantoms_are_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "tradeoff"]) == 2
    assert "--phantoms FILE is missing" in capsys.readouterr().err


@pytest.mark.slow
def test_panels_of_devices_show_what_an_untold_solver_would_see(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    path.write_text(json.dumps([{"name": "soft", "border_mm": 4.0}, {"name": "gauge", "gauge_factor": 1.0}]))
    panels = list(of_devices(str(path), ["units", "single", "press04"], 1, 1, Plan()))
    assert [one.name for one in panels] == [
        "soft, single", "soft, press04", "gauge, units", "gauge, single", "gauge, press04",
    ]  # fmt: skip
    assert [one.touches for one in panels if one.name.startswith("gauge")] == ["raise", "raise", "lower"]
    assert [len(one.cases) for one in panels] == [1, 1, 8, 1, 1]
    for one in panels:
        for case, truth in one.cases:
            assert np.isnan(case.sheet.untouched).all()
            assert case.lowering == (one.touches == "lower")
            assert truth.shape == case.sheet.skin.grid.shape
            assert truth.max() > 0.5


def test_what_is_measured_is_asked_for_and_possible(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "tradeoff", "--devices", "lab", "--draws", "0"]) == 2
    assert "--draws" in capsys.readouterr().err
    assert main(["bench", "tradeoff", "--devices", "lab", "--trials", "singel"]) != 0
    assert "expected some of mm, units" in capsys.readouterr().err
