"""The stability bench: its arithmetic, the rules that it must hold, and a thinned run of everything."""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eitskin.model.bundle import default_path, load_bundle
from eitskin_tools.bench.harness import chosen, several
from eitskin_tools.bench.stability import (
    FAMILIES,
    crossing,
    is_sound,
    noisy,
    repeat_rows,
)
from eitskin_tools.bench.stability_inputs import attacks, strike
from eitskin_tools.bench.stability_probe import Stream, Tally, samples
from eitskin_tools.cli import main

TINY = Path(__file__).parents[2] / "golden" / "tiny.eitskin"


def test_where_values_fall_below_a_threshold_is_interpolated():
    levels = [80.0, 60.0, 40.0, 20.0]
    assert crossing(levels, [1.0, 0.95, 0.75, 0.25], 0.9) == pytest.approx(55.0)  # a quarter of the way from 0.95
    assert crossing(levels, [1.0, 0.95, 0.75, 0.25], 0.5) == pytest.approx(30.0)
    assert crossing(levels, [1.0, 1.0, 1.0, 0.95], 0.9) is None
    assert crossing([1.0, 2.0], [0.1, 0.0], 0.5) == 1.0
    assert crossing([1.0, 2.0], [1.0, float("nan")], 0.5) == 2.0


def test_the_tally_notices_every_map_that_must_not_be_published():
    tally = Tally()
    for image in ([0.0, 1.0], [0.0, np.nan], [np.inf, 0.0], [-1e-9, 1.0], [0.5, 1.0000001]):
        tally.count(np.array(image))
    assert (tally.published, tally.not_finite, tally.out_of_range) == (5, 2, 2)
    assert not is_sound(tally.summary())
    assert is_sound(Tally().summary())


def test_shipped_tikhonov_projections_are_stored_in_float32_and_finite():
    for labels in ("units", "area"):
        matrix = load_bundle(default_path(labels)).tikhonov()
        assert matrix.dtype == np.float32
        assert np.isfinite(matrix).all()


@pytest.fixture(scope="module")
def sample():
    return samples("units", 1, 6.0)[0]


def test_no_input_however_absurd_escapes_or_is_published_out_of_range(sample):
    bundle, tally = load_bundle(TINY), Tally()
    outcomes = [strike(attack, bundle, sample, tally) for attack in attacks(sample)]
    assert tally.escaped == []
    assert (tally.not_finite, tally.out_of_range) == (0, 0)
    assert tally.published > 100
    assert {"malformed", "duplicate", "configuration", "partial", "implausible", "no_signal"} <= set(tally.withheld)
    for outcome in outcomes:  # whatever was not published was refused in one line, or is counted by its reason
        sent = outcome.attack.group in ("counts", "reference", "volts per count")
        if sent and not outcome.refused:
            assert outcome.published + sum(outcome.withheld.values()) == len(outcome.attack.payloads), outcome


def test_a_touch_published_of_voltages_that_no_touch_can_make_would_be_noticed(sample):
    bundle, tally = load_bundle(TINY), Tally()
    random = next(attack for attack in attacks(sample) if attack.name == "random")
    outcome = strike(replace(random, touchless=True), bundle, sample, tally)
    assert outcome.escaped
    assert tally.escaped


def test_what_the_stream_shows_is_what_the_pipeline_publishes(sample):
    tally = Tally()
    stream = Stream(load_bundle(default_path("units")), tally)
    image = stream.show(sample)
    assert image is not None
    assert image.shape == (30, 45)
    assert np.array_equal(image, stream.show(sample))
    assert tally.published == 2
    assert stream.show(replace(sample, voltages=0.0 * sample.voltages)) is None
    assert tally.withheld["no_signal"] == 1


def test_rows_that_noise_drowns_cost_less_when_the_reference_says_how_much_they_vary():
    # Four touched sheets, the same 40 frames of each: N3 at 35 dB drowns a fifth of the rows. Maps are compared, not
    # scores, which saturate. Together 0.64 and 0.80 for two networks, a single sheet from 0.38 to 1.01.
    rng = np.random.default_rng(2)
    stream = Stream(load_bundle(default_path("units")), Tally())
    off = np.zeros(2)
    for one in samples("units", 4, 6.0):
        calm = stream.show(one)
        frames = [noisy(one, "N3", 35.0, rng) for _ in range(40)]
        for number, said in enumerate((False, True)):
            shown = [stream.show(frame if said else replace(frame, spread=None)) for frame in frames]
            off[number] += np.mean([np.mean((image - calm) ** 2) for image in shown])
    assert stream.pipeline.normaliser.weak_count > 3
    assert off[1] < 0.9 * off[0]


@pytest.mark.process
@pytest.mark.parametrize("labels", ["units", "area"])
def test_a_frame_gives_the_same_map_again(sample, labels):
    rows = repeat_rows(load_bundle(default_path(labels)), [sample])
    again = [row for row in rows if "run to run" in row["sweep"]]
    assert len(again) == 3
    assert all(row["bit_equal"] for row in again)
    assert all(row["worst"] < 1e-5 for row in rows)


@pytest.mark.slow
@pytest.mark.process
def test_the_quick_form_publishes_nothing_absurd(capsys):
    assert main(["bench", "stability", "--quick", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)  # one object, nothing else
    rows, summary = found["rows"], found["summary"]
    assert is_sound(summary), summary["first_escaped"]
    assert summary["published"] > 200
    assert {row["family"] for row in rows} == set(FAMILIES)
    assert all(row["why"] for row in rows)
    assert not any(isinstance(value, list | dict) for row in rows for value in row.values())
    strongest = {row["solver"]: row for row in rows if row["sweep"] == "noise N3"}
    assert set(strongest) >= {"vd2t", "tikhonov"}
    assert strongest["vd2t"]["worst"] < strongest["vd2t"]["unstressed"]


def test_several_names_may_be_asked_for_at_once_and_others_are_refused():
    read = several(FAMILIES)
    assert chosen([read("inputs,noise"), read("repeat")], FAMILIES) == ("noise", "inputs", "repeat")
    assert chosen(None, FAMILIES) == FAMILIES
    with pytest.raises(argparse.ArgumentTypeError, match="'noises' is none of them"):
        read("noises")
