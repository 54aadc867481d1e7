"""Measured files: what they may hold, how they are judged, and one line for whatever is wrong with them."""

import json
import os
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import savemat
from tests.second_skin import SECOND

from eitskin_proto.sensor.table import RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import harness
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.scene.parts import Bend, Phantom, Scene, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import flat_voltages, predict
from eitskin_tools import cli
from eitskin_tools.evaluation import measured as measuring
from eitskin_tools.evaluation.measured_file import MeasuredFileError, load_measured

MESH_MM = 3.0
BENT = Bend(angle_deg=60, stretch_along=1.05)
DISC = Touch((Disc(60.0, 40.0, 6.0),))
PRESS = Touch((Disc(90.0, 55.0, 8.0),), contrast=0.5)


def volts(scene):
    return harness.solve_scene(replace(scene, element_size_mm=MESH_MM)).voltages


def share(touch):
    return harness.truth_map(Phantom("", Scene(touches=(touch,)), "area"))


@pytest.fixture(scope="module")
def arrays():
    """Five samples: bent, flat without a scan, and both untouched; the last touched again."""
    rng = np.random.default_rng(0)
    flat, bent = volts(Scene()), volts(Scene(bend=BENT))
    touched, bent_touched = volts(Scene(touches=(DISC,))), volts(Scene(bend=BENT, touches=(DISC,)))
    clean = np.array([bent_touched, bent, touched, flat, bent_touched])
    empty, disc = np.zeros((30, 45)), share(DISC)
    return {
        "reference_V": flat,
        "voltages_V": add_noise(clean, flat, "N2", 55.0, rng),
        "cloud_mm": measured_cloud(BENT, rng)[None],
        "cloud_index": np.array([0, 0, -1, -1, 0]),
        "truth": np.array([disc, empty, disc, empty, disc]),
        "kind": np.array(["single", "untouched", "single", "untouched", "again"]),
        "touch_kind": "raise",
    }


def written(tmp_path, arrays):
    path = tmp_path / "measured.npz"
    np.savez(path, **arrays)
    return str(path)


def evaluated(tmp_path, arrays, capsys, *words):
    assert cli.main(["evaluate", "--measured", written(tmp_path, arrays), "--json", *words]) == 0
    return json.loads(capsys.readouterr().out)


def test_every_sample_and_every_kind_is_judged(tmp_path, arrays, capsys):
    found = evaluated(tmp_path, arrays, capsys)
    assert found["solver"] == "vd2t"
    assert [set(one) for one in found["samples"]] == [{"kind", "cc", "localisation_mm", "touched", "peak"}] * 5
    assert [one["touched"] for one in found["samples"]] == [True, False, True, False, True]
    assert [one["cc"] is None for one in found["samples"]] == [False, True, False, True, False]
    single, untouched = found["by_kind"]["single"], found["by_kind"]["untouched"]
    assert single["cc"] == pytest.approx(np.mean([found["samples"][i]["cc"] for i in (0, 2)]))
    assert single["cc_worst"] == min(found["samples"][i]["cc"] for i in (0, 2)) > 0.9
    assert single["missed"] == 0.0
    assert single["localisation_rms_mm"] < 1.5
    assert single["false_touch"] is None
    assert untouched["false_touch"] == 0.0
    assert untouched["cc"] is untouched["missed"] is None
    assert list(found["by_kind"]) == ["single", "untouched", "again"]


@pytest.mark.parametrize("solver", ["tikhonov", "l1-units"])
def test_classical_solvers_look_for_what_the_touch_kind_says(tmp_path, arrays, capsys, solver):
    pressed = {
        "reference_V": arrays["reference_V"],
        "voltages_V": volts(Scene(touches=(PRESS,)))[None],
        "truth": share(PRESS)[None],
    }
    lowering = evaluated(tmp_path, {**pressed, "touch_kind": "lower"}, capsys, "--solver", solver)
    raising = evaluated(tmp_path, {**pressed, "touch_kind": "raise"}, capsys, "--solver", solver)
    assert lowering["by_kind"]["touched"]["missed"] == 0.0
    assert lowering["by_kind"]["touched"]["cc"] > 0.5 > raising["by_kind"]["touched"]["cc"] + 0.3


def test_a_reference_with_a_scan_stands_for_the_flat_sheet(tmp_path, arrays, capsys):
    stretched = Bend(stretch_along=1.03)
    tikhonov = ("--solver", "tikhonov", "--reference", "predicted")
    taken = {**arrays, "reference_V": volts(Scene(bend=stretched))}
    before = evaluated(tmp_path, taken, capsys, *tikhonov)["by_kind"]["single"]["cc"]
    cloud = measured_cloud(stretched, np.random.default_rng(1))
    after = evaluated(tmp_path, {**taken, "reference_cloud_mm": cloud}, capsys, *tikhonov)["by_kind"]["single"]["cc"]
    ideal = evaluated(tmp_path, arrays, capsys, *tikhonov)["by_kind"]["single"]["cc"]
    assert before < ideal - 0.05
    assert abs(after - ideal) < 0.02
    assert np.allclose(flat_voltages() / predict(flat_cloud()), 1.0, atol=1e-7)


def test_a_touch_is_missed_by_its_own_distance_and_localised_over_those_found():
    def one(*distances):
        return measuring.SampleScore("k", True, 1.0, len(distances), 0.5, 1.0, distances)

    found = measuring.summary([one(3.0, 20.0), one(4.0), one(np.inf)])
    assert found["missed"] == pytest.approx(2 / 4)
    assert found["localisation_rms_mm"] == pytest.approx(np.sqrt((9 + 16) / 2))
    assert measuring.summary([one(np.inf)])["localisation_rms_mm"] is None


def test_without_a_truth_the_gate_alone_is_reported(tmp_path, arrays, capsys):
    bare = {name: arrays[name] for name in ("reference_V", "voltages_V", "cloud_mm", "cloud_index", "kind")}
    found = evaluated(tmp_path, {**bare, "note": "tank 3"}, capsys, "--reference", "pre", "--solver", "tikhonov")
    assert found["ignored"] == ["note"]
    assert found["by_kind"]["untouched"]["false_touch"] == 0.0
    assert found["by_kind"]["single"]["cc"] is None
    del bare["kind"]
    assert list(evaluated(tmp_path, bare, capsys, "--solver", "tikhonov")["by_kind"]) == ["unknown"]


NAN = np.full((5, 104), np.nan)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"voltages_V": np.ones((5, 103))}, "(5, 103), expected (n, 104)"),
        ({"voltages_V": np.ones((5, 207))}, "(5, 207), expected (n, 104)"),
        ({"voltages_V": NAN}, "voltages_V[0, 0] is nan"),
        ({"voltages_V": None}, "lacks voltages_V"),
        ({"reference_V": np.zeros(104)}, "zeros"),
        ({"reference_cloud_mm": np.zeros((3, 30, 45))}, "reference_cloud_mm"),
        ({"cloud_mm": np.ones((1, 3, 30, 45))}, "cloud_mm[0]"),
        ({"cloud_mm": None}, "has only cloud_index"),
        ({"cloud_index": np.array([0, 0, -1, -1, 1])}, "cloud_index[4] is 1"),
        ({"truth": np.zeros((4, 30, 45))}, "(5, 30, 45)"),
        ({"truth": np.full((5, 30, 45), 1.5)}, "from 0 to 1"),
        ({"kind": np.array(["untouched"] * 5)}, "kind[0]"),
        ({"touch_kind": "both"}, "lower, raise"),
        ({"grid_id": "0123456789abcdef"}, f"expected {PAPER.grid_id}"),
        ({"grid_id": SECOND.grid_id, "skin_digest": PAPER.digest}, f"expected {PAPER.grid_id} of skin"),
    ],
)
def test_whatever_is_wrong_is_one_line(tmp_path, arrays, capsys, change, said):
    given = {name: array for name, array in {**arrays, **change}.items() if array is not None}
    assert cli.main(["evaluate", "--measured", written(tmp_path, given), "--json"]) == 1
    out, line = capsys.readouterr()
    assert out == ""
    assert line.count("\n") == 1
    assert said in line
    assert line.startswith("eitskin evaluate: ")


def test_rows_of_a_full_scan_are_averaged_with_their_reciprocals(tmp_path, arrays):
    full = np.zeros((5, 208))
    full[:, ROW_IN_FULL], full[:, RECIPROCAL_IN_FULL] = 1.1 * arrays["voltages_V"], 0.9 * arrays["voltages_V"]
    found = load_measured(written(tmp_path, {**arrays, "voltages_V": full}))
    np.testing.assert_allclose(found.voltages_V, arrays["voltages_V"], rtol=1e-12)
    with pytest.raises(MeasuredFileError, match="208 rows of which most differ threefold from their reciprocals"):
        load_measured(written(tmp_path, {**arrays, "voltages_V": np.tile(arrays["voltages_V"], 2)}))


def test_matlab_and_text_hold_the_same_samples(tmp_path, arrays):
    savemat(
        tmp_path / "m.mat", {**arrays, "reference_V": arrays["reference_V"][None], "kind": arrays["kind"].astype("O")}
    )
    found = load_measured(tmp_path / "m.mat")
    assert found.kinds == tuple(arrays["kind"])
    assert found.touch_kind == "raise"
    np.testing.assert_array_equal(found.truth, arrays["truth"])
    np.testing.assert_array_equal(found.cloud_index, arrays["cloud_index"])
    lines = [",".join(map(repr, row.tolist())) for row in (arrays["reference_V"], *arrays["voltages_V"])]
    (tmp_path / "m.csv").write_text("\ufeff" + "\n".join([",".join(f"V{k}" for k in range(104)), *lines, ""]))
    text = load_measured(tmp_path / "m.csv")
    np.testing.assert_array_equal(text.voltages_V, arrays["voltages_V"])
    np.testing.assert_array_equal(text.reference_V, found.reference_V)
    commas = "; by hand\n" + "\n".join(lines).replace(",", ";").replace(".", ",") + ";"
    (tmp_path / "m.csv").write_text(commas, encoding="utf-16")
    np.testing.assert_array_equal(load_measured(tmp_path / "m.csv").voltages_V, arrays["voltages_V"])
    np.savetxt(tmp_path / "m.txt", np.vstack([arrays["reference_V"], arrays["voltages_V"]]))
    np.testing.assert_array_equal(load_measured(tmp_path / "m.txt").voltages_V, arrays["voltages_V"])
    (tmp_path / "m.csv").write_text("\n".join(line.replace(".", ",") for line in lines))
    with pytest.raises(MeasuredFileError, match="beside decimal commas, separate by semicolons"):
        load_measured(tmp_path / "m.csv")
    (tmp_path / "m.csv").write_text("\n".join(f"{line[:9]},,{line[9:]}" for line in lines))
    with pytest.raises(MeasuredFileError, match="line 2 holds"):  # an empty column shifts the others
        load_measured(tmp_path / "m.csv")
    (tmp_path / "m.csv").write_text("1,2\n3,x\n")
    with pytest.raises(MeasuredFileError, match=r"line 2 holds '3,x', expected numbers"):
        load_measured(tmp_path / "m.csv")
    (tmp_path / "m.mat").write_bytes(b"nonsense")
    with pytest.raises(MeasuredFileError, match="no file of MATLAB up to version 7"):
        load_measured(tmp_path / "m.mat")


@pytest.mark.parametrize("what", ["none", "folder", "text", "pickled", "objects", "cut"])
def test_what_is_no_measured_file_is_one_line_and_nothing_is_unpickled(tmp_path, arrays, capsys, what):
    path = tmp_path / "measured.npz"
    if what == "folder":
        path.mkdir()
    elif what == "text":
        path.write_text("voltages")
    elif what == "pickled":
        path.write_bytes(pickle.dumps(Trap()))
    elif what == "objects":
        np.savez(path, **{**arrays, "kind": np.array([Trap()] * 5)})
    elif what == "cut":
        np.savez(path, **arrays)
        path.write_bytes(path.read_bytes()[:-2000])
    assert cli.main(["evaluate", "--measured", str(path)]) == 1
    out, line = capsys.readouterr()
    assert out == ""
    assert line.count("\n") == 1
    assert "measured.npz" in line


class Trap:
    """Pickled, it would end the process that unpickles it."""

    def __reduce__(self):
        return os._exit, (3,)


@pytest.mark.parametrize(
    ("words", "status"),
    [(["--reference", "post"], 1), (["--shift-px", "0.5"], 2), (["--single", "9"], 2)],
)
def test_what_a_recording_cannot_tell_is_refused(tmp_path, arrays, capsys, words, status):
    assert cli.main(["evaluate", "--measured", written(tmp_path, arrays), *words]) == status
    assert capsys.readouterr().err.count("\n") == 1
