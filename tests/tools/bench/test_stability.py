"""The stability bench: its arithmetic, the rules that it must hold, and a thinned run of everything."""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eitskin.health.imputation import Consistency, Imputation
from eitskin.model.bundle import default_path, load_bundle
from eitskin_export.projection import FACTOR as PROJECTION_FACTOR
from eitskin_export.projection import tikhonov
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.solvers.operators import build_operators
from eitskin_sim.solvers.tikhonov import FACTOR, tikhonov_matrix
from eitskin_tools.bench.harness import chosen, several
from eitskin_tools.bench.stability import jobs
from eitskin_tools.bench.stability.bench import FAMILIES, is_sound, table
from eitskin_tools.bench.stability.harness.rows import Curve, Point, crossing
from eitskin_tools.bench.stability.harness.samples import sample_of, samples, system_of, voltages_of
from eitskin_tools.bench.stability.harness.stream import Stream
from eitskin_tools.bench.stability.harness.sweep import Effort, thinned
from eitskin_tools.bench.stability.harness.tally import Tally
from eitskin_tools.bench.stability.sweeps.inputs import attacks, strike
from eitskin_tools.bench.stability.sweeps.meshes import triangle_rows
from eitskin_tools.bench.stability.sweeps.noise import spread_of
from eitskin_tools.bench.stability.sweeps.precision import LOST, apart, built, filling_weights, precision_rows
from eitskin_tools.bench.stability.sweeps.repeat import repeat_rows
from eitskin_tools.bench.stability.sweeps.shape import block
from eitskin_tools.cli import main

LEAST = Effort(samples=1, draws=1, levels=2, element_size_mm=6.0)
TINY = Path(__file__).parents[2] / "golden" / "tiny.eitskin"


def curve(values, levels=(80.0, 60.0, 40.0, 20.0), logarithmic=False, withheld=(0.0, 0.0, 0.0, 0.0)):
    points = tuple(Point(level, a, 0.1, w) for level, a, w in zip(levels, values, withheld, strict=True))
    return Curve("noise", "vd2t", "dB", 1.0, points, logarithmic)


def test_a_curve_says_where_a_tenth_is_lost_and_where_it_halves_between_its_levels():
    falling = curve([1.0, 0.95, 0.75, 0.25])
    assert falling.degrades_at() == pytest.approx(55.0)  # from 0.95 at 60 to 0.75 at 40, 0.9 is a quarter of the way
    assert falling.breaks_at() == pytest.approx(30.0)
    assert curve([1.0, 1.0, 1.0, 0.95]).degrades_at() is None
    assert curve([1.0, 1.0, 1.0, 0.95]).breaks_at() is None


def test_half_of_the_frames_withheld_is_a_break_even_of_perfect_maps():
    assert curve([1.0] * 4, withheld=(0.0, 0.0, 0.4, 0.6)).breaks_at() == pytest.approx(30.0)


def test_crossings_are_interpolated_on_the_axis_they_are_drawn_on():
    assert crossing([1.0, 100.0], [1.0, 0.0], 0.5, True) == pytest.approx(10.0)
    assert crossing([1.0, 100.0], [1.0, 0.0], 0.5, False) == pytest.approx(50.5)
    assert crossing([1.0, 2.0], [0.1, 0.0], 0.5, False) == 1.0
    assert crossing([1.0, 2.0], [1.0, float("nan")], 0.5, False) == 2.0


def test_thinned_levels_keep_both_ends():
    assert thinned((1.0, 2.0, 3.0, 4.0, 5.0), 3) == (1.0, 3.0, 5.0)
    assert thinned((1.0, 2.0), 9) == (1.0, 2.0)


def test_the_tally_notices_every_map_that_must_not_be_published():
    tally = Tally()
    for image in ([0.0, 1.0], [0.0, np.nan], [np.inf, 0.0], [-1e-9, 1.0], [0.5, 1.0000001]):
        tally.take(np.array(image))
    assert (tally.published, tally.not_finite, tally.out_of_range) == (5, 2, 2)
    assert not is_sound(tally.summary())
    assert is_sound(Tally().summary())


def test_blocks_of_units_lie_on_the_sheet_and_have_the_size_asked_for():
    for units in (1, 4, 81, 108, 126):
        cells = block(units)
        assert len(set(cells)) == units
        assert all(0 <= column < 14 and 0 <= row < 9 for column, row in cells)
    with pytest.raises(ValueError, match="make no block"):
        block(17)


def test_operators_are_built_in_float64_and_rounded_once_where_float32_would_spoil_them():
    # The damped Gram matrix has the condition 1 / factor: float32 leaves 6e-8 / factor of error in what is built with
    # it, and about 3e-8 in what is only stored in it. A factor of 10 between them is the verdict's margin.
    operators = build_operators(cells="units").relative_jacobian
    exact = tikhonov_matrix(operators)
    assert apart(exact.astype(np.float32), exact) < 1e-7
    assert apart(built(operators, FACTOR, 0.5, np.float32), exact) > 1e-5
    assert apart(built(operators, FACTOR, 0.5, np.float64), exact) < 1e-10  # the same formula, told apart by type alone
    pixels = build_operators(cells="pixels").relative_jacobian
    shipped, built_small = tikhonov(pixels), built(pixels, PROJECTION_FACTOR, 0.0, np.float32)
    in_double = built(pixels, PROJECTION_FACTOR, 0.0, np.float64)
    assert apart(shipped, np.asarray(in_double)) < 1e-7
    assert apart(built_small, np.asarray(in_double)) > 1e-6


def test_what_fills_rows_in_is_built_in_float64_and_would_lose_three_digits_in_float32():
    arrays = load_bundle(default_path("units")).consistency_arrays()
    if arrays is None:
        pytest.skip("the shipped bundle has no consistency.npz; 'eitskin export' makes one")
    known = Consistency.of(arrays)
    assert known.precision().dtype == np.float64
    row = next(row for row in precision_rows(samples("units", 1, 6.0)[0], 2, known) if row["solver"] == "filling")
    assert "must be built in float64" in row["why"]
    exact = filling_weights(known.covariance, 0.0, np.float64)
    rows = rows_of((LOST,))
    shipped = Imputation(known.mean, known.precision(), known.ratio_range)
    shipped.leave_out(rows, known.precision())
    change = np.expm1(known.mean + 0.01 * np.sin(np.arange(104.0)))
    expected = np.expm1(known.mean[rows] - exact @ (0.01 * np.sin(np.arange(104.0)))[~rows])
    assert np.abs(shipped.filled(change[None])[0, rows] - expected).max() < 1e-9  # the runtime's is the one in float64


def test_the_smaller_the_regularisation_the_worse_is_a_matrix_built_in_float32():
    operators = build_operators(cells="units").relative_jacobian
    errors = [
        apart(built(operators, f, 0.5, np.float32), tikhonov_matrix(operators, f, 0.5)) for f in (1e-2, 1e-4, 1e-6)
    ]
    assert errors[0] < errors[1] < errors[2]
    assert errors[2] > 100 * errors[0]


def test_shipped_tikhonov_projections_are_stored_in_float32_and_finite():
    for labels in ("units", "area"):
        matrix = load_bundle(default_path(labels)).tikhonov()
        assert matrix.dtype == np.float32
        assert np.isfinite(matrix).all()


def test_flat_triangles_harm_when_an_angle_nears_180_degrees_and_needles_do_not():
    needles, caps = triangle_rows()
    assert needles["breaks_at"] is None
    assert needles["worst"] == needles["unstressed"]  # one side ever shorter only helps
    assert caps["breaks_at"] is not None
    assert caps["worst"] > 3 * caps["unstressed"]


@pytest.fixture(scope="module")
def sample():
    return samples("units", 1, LEAST.element_size_mm)[0]


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
    stream = Stream(load_bundle(default_path("units")), tally, gated=False)
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
    stream = Stream(load_bundle(default_path("units")), Tally(), gated=False)
    off = np.zeros(2)
    for one in samples("units", 4, LEAST.element_size_mm):
        calm = stream.show(one)
        noisy = [add_noise(one.voltages, one.flat, "N3", 35.0, rng) for _ in range(40)]
        for number, spread in enumerate((None, spread_of(one, "N3", 35.0))):
            shown = [stream.show(replace(one, voltages=volts, spread=spread)) for volts in noisy]
            off[number] += np.mean([np.mean((image - calm) ** 2) for image in shown])
    assert stream.pipeline.normaliser.weak_count > 3
    assert off[1] < 0.9 * off[0]


@pytest.mark.process
@pytest.mark.parametrize("labels", ["units", "area"])
def test_a_frame_gives_the_same_map_again_and_a_head_of_single_frames_says_so(sample, labels):
    bundle = load_bundle(default_path(labels))
    rows = {(row["sweep"], row["solver"]): row for row in repeat_rows(bundle, [sample])}
    again = [row for (sweep, _), row in rows.items() if "run to run" in sweep]
    assert len(again) == 3
    assert all(row["bit_equal"] for row in again)
    batch = rows["repeat: batch of 1, batch of 16", "vd2t"]
    if bundle.manifest["recipe"]["architecture"].get("symmetric"):
        assert "four images" in batch["why"]
    elif "left out" in batch["why"]:
        assert "of one" in batch["why"]
    else:
        assert 0.0 <= batch["worst"] < 1e-5


@pytest.mark.slow
@pytest.mark.process
def test_the_quick_form_explains_every_break_and_publishes_nothing_absurd(capsys):
    assert main(["bench", "stability", "--quick", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)  # one object, nothing else
    rows, curves, summary = found["rows"], found["curves"], found["summary"]
    assert is_sound(summary), summary["first_escaped"]
    assert summary["published"] > 2000
    assert summary["broken"] > 20
    assert summary["broken_unexplained"] == summary["jobs_left_out"] == 0
    assert {row["family"] for row in rows} == set(FAMILIES)
    assert all(row["why"] for row in rows)
    assert all(any(character.isdigit() for character in row["why"]) for row in rows if row["breaks_at"] is not None)
    assert not any(isinstance(value, list | dict) for row in rows for value in row.values())
    strongest = {one["solver"]: one for one in curves if one["sweep"] == "noise N3"}
    assert {"vd2t", "vd2t (free)", "sbl", "gate"} <= set(strongest)
    assert strongest["vd2t"]["accuracy"][-1] < strongest["vd2t"]["accuracy"][0]


def test_a_run_that_is_stopped_gives_what_it_has_and_says_what_is_missing(monkeypatch):
    def stopped():
        raise KeyboardInterrupt

    found = [{"sweep": "one", "solver": "vd2t", "why": "1"}]
    plan = [jobs.Job("noise", "one", 30.0, lambda: [(found[0], None)]), jobs.Job("shape", "two", 10.0, stopped)]
    monkeypatch.setattr(jobs, "jobs_of", lambda *given, **named: iter(plan))
    said = []
    rows, curves, summary = table([], LEAST, say=said.append)
    assert rows == [{"family": "noise", **found[0]}]
    assert curves == []
    assert (summary["jobs"], summary["jobs_left_out"]) == (2, 1)
    assert said[0] == "noise: one"
    assert said[-1] == "stopped: 1 of 2 jobs are left out"
    assert any(line.startswith("[1/2]") for line in said)


def test_the_time_left_is_what_the_jobs_behind_take_beside_those_before():
    plan = [jobs.Job("noise", str(n), work, list) for n, work in enumerate((30.0, 10.0, 5.0))]
    progress = jobs.Progress(plan, start_s=time.perf_counter() - 60.0)
    assert progress.step() == "[1/3] 60 s so far, about 30 s left"  # 15 of 45 are behind, 30 took a minute


def test_several_names_may_be_asked_for_at_once_and_others_are_refused():
    read = several(FAMILIES)
    assert chosen([read("inputs,noise"), read("repeat")], FAMILIES) == ("noise", "inputs", "repeat")
    assert chosen(None, FAMILIES) == FAMILIES
    with pytest.raises(argparse.ArgumentTypeError, match="'noises' is none of them"):
        read("noises")


def test_scenes_that_differ_in_conductivities_share_their_assembly_and_are_solved_as_by_themselves(sample):
    scene = sample.scene
    drier = replace(scene, sheet=replace(scene.sheet, conductivity_S_per_m=0.7), current_A=2.0)
    assert system_of(drier).stiffness is system_of(scene).stiffness
    assert np.array_equal(voltages_of(drier), solve_scene(drier).voltages)
    assert np.array_equal(sample_of(scene, "units").voltages, solve_scene(scene).voltages)


def test_curves_are_drawn(tmp_path):
    pytest.importorskip("matplotlib", reason="pictures come with the extra 'plot'")
    from eitskin_tools.bench.stability.draw import draw_curves

    path = tmp_path / "curves.png"
    draw_curves([curve([1.0, 0.9, 0.6, 0.2])], path)
    assert path.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="no curves"):
        draw_curves([], path)
