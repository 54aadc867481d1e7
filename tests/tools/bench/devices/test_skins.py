"""How many skins a machine carries: what rows come to, and that a busy machine is not judged. Nothing is run."""

import argparse
import json
from typing import Any

import pytest

from eitskin_tools.bench.skins import bench


def row(what: str, skins: int, us: int, lost: int = 0, withheld: int = 0, not_taken: int = 0, others: int = 10) -> Any:
    return {"round": 1, "what": what, "skins": skins, "lost": lost, "withheld": withheld, "not_taken": not_taken,
            "cpu_us_a_frame": us, "others_core_percent": others}  # fmt: skip


def rows() -> list[dict[str, Any]]:
    return [
        row("untouched", 1, 100), row("untouched", 2, 110), row("untouched", 4, 120),
        row("touched", 1, 300), row("touched", 2, 330, not_taken=1), row("touched", 4, 360),
    ]  # fmt: skip


def test_a_summary_has_medians_and_the_most_skins_below_the_first_loss() -> None:
    assert bench.summary(rows(), 2) == {
        "not_concluded": "",
        "untouched_cpu_us_a_frame": 110,
        "untouched_most_without_loss": 4,
        "touched_cpu_us_a_frame": 330,
        "touched_most_without_loss": 1,  # four went well once, but two did not
        "touched_to_untouched": 3.0,
    }


@pytest.mark.parametrize("kind", ["lost", "withheld", "not_taken"])
def test_whatever_is_lost_in_any_round_counts(kind: str) -> None:
    lossy: Any = {kind: 1}
    found = bench.summary([*rows(), row("untouched", 1, 100, **lossy)], 2)
    assert found["untouched_most_without_loss"] == 0


@pytest.mark.parametrize(("others", "cores", "busy"), [(50, 2, False), (51, 2, True), (51, 4, False)])
def test_where_others_take_much_of_the_machine_nothing_is_concluded(others: int, cores: int, busy: bool) -> None:
    found = bench.summary([*rows(), row("untouched", 8, 120, others=others)], cores)
    most = [found[f"{kind}_most_without_loss"] for kind in bench.SCENES]
    assert most == ([None, None] if busy else [8, 1])
    assert bool(found["not_concluded"]) == busy
    assert found["touched_to_untouched"] > 2.0


def test_it_says_so_in_a_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(bench, "measure", lambda *_: [*rows(), row("touched", 1, 300, others=180)])
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1})
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    assert bench.run(parser.parse_args([])) == 0
    *_, figures, last = capsys.readouterr().out.splitlines()
    assert last == (
        "how many skins 2 cores carry is not concluded: other programs took up to 180 % of a core, expected at most "
        "50 %; run it while little else runs"
    )
    assert "most_without_loss" not in figures
    assert "touched_cpu_us_a_frame" in figures
    assert bench.run(parser.parse_args(["--json"])) == 0
    found = json.loads(capsys.readouterr().out)["summary"]
    assert found["untouched_most_without_loss"] is None
    assert found["not_concluded"] == last
