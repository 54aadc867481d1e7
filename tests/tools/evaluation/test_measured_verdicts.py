"""``evaluate --measured FILE --solver verified``: what physics says stands with every sample and every kind."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin_sim.evaluation.harness import Run
from eitskin_sim.surface.predict import flat_voltages
from eitskin_sim.verification.snapped_units import UnitVerdict
from eitskin_tools import cli
from eitskin_tools.evaluation import measured as measuring
from eitskin_tools.evaluation.solvers import Named
from eitskin_tools.evaluation.verified.solver import MapVerdict

SAID = [(0.4, 2.0), (0.001, 3.0), (0.9, 4.0)]
"""p and ms of each sample."""


@pytest.fixture
def command(tmp_path, monkeypatch):
    """The command on three samples, with a verifier that says what is above."""
    said, checked = iter(SAID), []

    def solve(case):
        p, extra_ms = next(said)
        verdict = UnitVerdict((), 100.0, 104, p, 0.01, 5, 1e-3 * extra_ms)
        checked.append(MapVerdict(verdict, extra_ms, extra_ms, 0.0))
        return np.zeros((30, 45))

    verified = Named(Run(solve, "pre"), verified=SimpleNamespace(checked=checked))
    monkeypatch.setattr(measuring, "named", lambda *_, **__: verified)
    flat = flat_voltages()
    kinds = np.array(["single", "single", "untouched"])
    np.savez(tmp_path / "measured.npz", reference_V=flat, voltages_V=np.tile(flat, (3, 1)), kind=kinds)
    return ["evaluate", "--measured", str(tmp_path / "measured.npz"), "--solver", "verified"]


def test_samples_and_kinds_have_p_flag_and_time(command, capsys):
    assert cli.main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [(one["p_value"], one["extra_ms"]) for one in found["samples"]] == SAID
    assert [one["flagged"] for one in found["samples"]] == [False, True, False]
    single = found["by_kind"]["single"]
    assert (single["p_value"], single["flagged"], single["extra_ms"]) == (pytest.approx(0.2005), 0.5, 2.5)
    assert found["by_kind"]["untouched"]["p_value"] == 0.9
