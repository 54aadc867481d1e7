"""Which shipped bundle a network's figures are of: by labels and by what touches."""

from pathlib import Path

from eitskin.model import bundle as bundles
from eitskin_tools.evaluation.solvers import Request, bundle_for

TINY = Path(__file__).parents[2] / "golden" / "tiny.eitskin"


def test_the_bundle_is_the_one_for_labels_and_touches(monkeypatch, tmp_path):
    shipped = bundles.default_path
    monkeypatch.setattr(bundles, "default_path", lambda *kind: tmp_path / shipped(*kind).name)
    for name in ("free", "units", "press"):
        (tmp_path / f"{name}.eitskin").write_bytes(TINY.read_bytes())
    request = Request("vd2t")
    assert bundle_for(request, "area").path.stem == "free"
    assert bundle_for(request, "area", "lower").path.stem == "press"
    assert bundle_for(request, "units").path.stem == "units"
    assert bundle_for(request, "units", "lower").path.stem == "units", "there is none for presses on units"
    assert bundle_for(Request("vd2t", bundle=TINY), "area", "lower").path == TINY
