import json
from pathlib import Path

import pytest

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
