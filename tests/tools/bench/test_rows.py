"""A benchmark's row as people read it."""

from eitskin_tools.bench.rows import row_text


def test_what_was_measured_stands_in_front_of_its_figures():
    assert row_text({"what": "operators, pixels", "median_ms": 93.0, "cpu_ms": 80.8}) == (
        "operators, pixels:  median_ms 93.0  cpu_ms 80.8"
    )
    assert row_text({"round": 1, "what": "untouched", "skins": 2}) == "untouched:  round 1  skins 2"


def test_a_summary_is_its_figures_alone():
    assert row_text({"samples": 3, "cc": 0.5}) == "samples 3  cc 0.5"
