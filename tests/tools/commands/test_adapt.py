"""``eitskin adapt``: what the adapted run says of its data."""

from types import SimpleNamespace

from eitskin_tools.cli import main
from eitskin_training import adapt, run_files


def test_the_export_finds_the_data_wherever_it_is_called(tmp_path, monkeypatch):
    (tmp_path / "run").mkdir()
    monkeypatch.chdir(tmp_path)
    written = {}
    found = SimpleNamespace(model=None, recipe=None, content={"data": ["/gone"], "seed": 1})
    scores = SimpleNamespace(facts={"before": {"whole": 1.0}, "after": {"whole": 1.0}})
    monkeypatch.setattr(run_files, "trained", lambda _: found)
    monkeypatch.setattr(run_files, "data_of", lambda _, given: given)
    monkeypatch.setattr(adapt, "adapt", lambda *_, **__: scores)
    monkeypatch.setattr(adapt, "write", lambda out, content, _: written.update(content) or out)
    assert main(["adapt", "run", "--out", "adapted", "--data", "here", "there"]) == 0
    assert written["data"] == [str(tmp_path / "here"), str(tmp_path / "there")]
    assert main(["adapt", "run", "--out", "adapted"]) == 0
    assert written["data"] == ["/gone"]
