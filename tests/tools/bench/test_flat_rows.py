"""What ``--json`` of a benchmark promises: ``rows``, a list of flat objects, and ``summary``."""

from typing import Any

from eitskin_tools.bench import skip
from eitskin_tools.bench import tradeoff as front


def is_flat(rows: list[dict[str, Any]]) -> bool:
    return all(not isinstance(value, dict | list) for row in rows for value in row.values())


def test_skips_are_flat_rows_with_the_time_of_each_way() -> None:
    us = {"with": {"cpu_mean": 2.0, "cpu_p50": 1.9}, "without": {"cpu_mean": 8.0, "cpu_p50": 7.9}}
    skips = {
        "untouched": {"us": us, "cpu_saved_us": 6.0, "cpu_left": 0.25},
    }
    rows = skip.flat_rows(skips)
    assert is_flat(rows)
    assert rows[0] == {"what": "untouched", "cpu_saved_us": 6.0, "cpu_left": 0.25, "with_us": 2.0, "without_us": 8.0}
    assert skip.summary(skips) == {"untouched_cpu_left": 0.25}


def test_variants_of_all_panels_are_flat_rows() -> None:
    rows = [
        {"variant": "vd2t", "error": 0.02, "p50": 400.0},
        {"variant": "sbl", "error": 0.03, "p50": 500.0},
    ]
    front.mark_front(rows)
    panels = {"paper_mm": rows, "paper_units": rows[:1]}
    flat = front.flat_rows(panels)
    assert is_flat(flat)
    assert [(row["panel"], row["variant"]) for row in flat] == [
        ("paper_mm", "vd2t"), ("paper_mm", "sbl"), ("paper_units", "vd2t"),
    ]  # fmt: skip
    assert front.summary(panels)["paper_mm"] == {"most_accurate": "vd2t", "on_front": ["vd2t"]}
