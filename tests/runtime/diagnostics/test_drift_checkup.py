"""What the doctor says of drift: how far, how sure, and what to do; a touch is no drift."""

import json

import numpy as np
import pytest

from eitskin.diagnostics.drift_checkup import drift_since, lines
from eitskin.errors import BadReference
from eitskin.reference.captured import Reference, save

ROWS = np.arange(104)
FLAT = 1e-3 * 40.0 ** (-ROWS / 103.0)
NOISE = 0.003


def reference(volts=FLAT):
    return Reference(volts, NOISE * np.abs(volts), 100, "TEST-1", 7, "paper", "2026-11-01T00:00:00Z")


def frames(factor, uneven=0.0, seed=0, count=100):
    rng = np.random.default_rng(seed)
    sheet = FLAT * factor * (1.0 + uneven * np.cos(1.7 * ROWS))
    return sheet * (1.0 + NOISE * rng.standard_normal((count, 104)))


@pytest.mark.parametrize(
    ("factor", "said"),
    [(1.0, "nothing to do"), (1.03, "the runtime corrects for it"), (0.85, "capture a new reference with")],
)
def test_a_common_drift_is_told_in_percent_with_its_standard_deviation(factor, said):
    found = drift_since(frames(factor), reference())
    assert abs(found["percent"] - 100.0 * (factor - 1.0)) < 4.0 * found["sd_percent"] + 0.01
    assert found["sd_percent"] < 0.05
    assert found["to_do"].startswith(said)
    assert f"{found['percent']:+.2f} % since the reference of 2026-11-01" in lines(found)[1]


def test_a_touch_is_not_called_drift():
    found = drift_since(frames(1.0, uneven=0.03), reference())
    assert found["uneven_percent"] == pytest.approx(2.1, abs=0.2)
    assert found["to_do"].startswith("the sheet is touched, bent, or has drifted unevenly")


def test_rows_that_tell_nothing_are_an_error_if_they_are_many():
    volts = frames(1.0)
    volts[:, :60] = 0.0
    with pytest.raises(BadReference, match="44 of 104 rows can be compared with the reference, expected 52"):
        drift_since(volts, reference())


def test_the_command_looks_at_recorded_frames(tmp_path, capsys):
    from eitskin_tools.cli import main

    np.save(tmp_path / "frames.npy", frames(1.03))
    save(reference(), tmp_path / "flat.json")
    words = ["doctor", "--drift", "--recorded", str(tmp_path / "frames.npy")]
    assert main([*words, "--reference", str(tmp_path / "flat.json"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["percent"] == pytest.approx(3.0, abs=0.1)
    assert main(words) == 2
    assert "--drift needs --reference FILE" in capsys.readouterr().err
    assert main([*words, "--electrodes"]) == 2
