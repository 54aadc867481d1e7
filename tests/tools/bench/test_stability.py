"""The stability bench: its arithmetic, the rules that it must hold, and a thinned run of everything."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from eitskin.model.bundle import default_path, load_bundle
from eitskin_tools.bench.stability import Stream, judged, touched_sheets
from eitskin_tools.cli import main


def test_every_map_that_must_not_be_published_is_counted():
    counts = Counter()
    for image in ([0.0, 1.0], [0.0, np.nan], [np.inf, 0.0], [-1e-9, 1.0], [0.5, 1.0000001]):
        counts.update(judged(np.array(image)))
    assert counts == {"published": 5, "published_not_finite": 2, "published_out_of_range": 2}


def test_shipped_tikhonov_projections_are_stored_in_float32_and_finite():
    for labels in ("units", "area"):
        matrix = load_bundle(default_path(labels)).tikhonov()
        assert matrix.dtype == np.float32
        assert np.isfinite(matrix).all()


@pytest.fixture(scope="module")
def sheet():
    return touched_sheets("units", 1, 6.0)[0]


def test_what_the_stream_shows_is_what_the_pipeline_publishes(sheet):
    counts = Counter()
    case, _ = sheet
    stream = Stream(load_bundle(default_path("units")), case.flat_reference, counts)
    image = stream.show(case)
    assert image is not None
    assert image.shape == (30, 45)
    assert np.array_equal(image, stream.show(case))
    assert counts["published"] == 2
    assert stream.show(replace(case, voltages=0.0 * case.voltages)) is None
    assert (counts["withheld"], counts["withheld_no_signal"]) == (1, 1)


@pytest.mark.slow
@pytest.mark.process
def test_the_quick_form_publishes_nothing_absurd(capsys):
    assert main(["bench", "stability", "--quick", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)  # one object, nothing else
    rows, summary = found["rows"], found["summary"]
    assert summary["published_not_finite"] == summary["published_out_of_range"] == 0
    assert summary["published"] > 50
    assert "withheld_frozen" not in summary
    assert all(row["why"] for row in rows)
    assert not any(isinstance(value, list | dict) for row in rows for value in row.values())
    strongest = {row["solver"]: row for row in rows if row["sweep"] == "noise N3"}
    assert set(strongest) >= {"vd2t", "tikhonov"}
    assert strongest["vd2t"]["worst"] < strongest["vd2t"]["unstressed"]
