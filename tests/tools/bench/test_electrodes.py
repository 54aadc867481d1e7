"""Failing electrodes from the circuit to the report: the benchmark's streams, and ``eitskin doctor --electrodes``."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from eitskin.diagnostics.electrode_checkup import ADVICE, UNKNOWN, Recording, check_up, lines, load_recording
from eitskin.errors import BadReference
from eitskin.health.gate_without_rows import GateWithoutRows
from eitskin.health.imputation import Consistency
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.gate import Gate
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import TABLE
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.measurement.faults import Detached, Fault, Shorted, Swapped, measure
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_tools.bench import electrodes as bench
from eitskin_tools.cli import main

pytestmark = pytest.mark.heavy


@cache
def consistency() -> Consistency:
    arrays = load_bundle(default_path("area")).consistency_arrays()
    if arrays is None:
        pytest.skip("the shipped bundle has no consistency.npz; 'eitskin export' makes one")
    return Consistency.of(arrays)


@cache
def flat() -> np.ndarray:
    return bench.flat_response()


@cache
def moving() -> bench.Stream:
    return bench.stream("A", 3, 3, covering=True)


def frames(fault: Fault | None, count: int = 40, current_A: float = 1e-3) -> np.ndarray:
    """Return (count, 104) V of a sheet that bends and is touched, on an electrode too."""
    rng, clean = np.random.default_rng(1), measure(flat(), table=TABLE)
    faults = () if fault is None else (fault,)
    shown = [measure(moving().at(frame), faults, table=TABLE, rng=rng) for frame in range(count)]
    return current_A * np.array([add_noise(volts, clean, "N2", 50.0, rng) for volts in shown])


@pytest.mark.parametrize(
    ("fault", "states"),
    [
        (None, {}),
        (Detached(5), {5: "detached"}),
        (Shorted(8, 9), {8: "shorted", 9: "shorted"}),
        (Swapped(12, 13), {12: "swapped", 13: "swapped"}),
    ],
)
def test_doctor_tells_a_failure_without_any_reference(fault: Fault | None, states: dict[int, str]) -> None:
    found = check_up(Recording(frames(fault), None), consistency())
    assert {one["electrode"]: one["state"] for one in found["electrodes"] if one["state"] != "well"} == states
    assert len(found["electrodes"]) == 16
    assert all(one["to_do"] == ADVICE[one["state"]] for one in found["electrodes"])


@pytest.mark.parametrize(
    ("order", "said"),
    [
        (np.random.default_rng(3).permutation(104), "the rows are in no known order"),
        (np.roll(np.arange(104), 1), "readings come 1 row late"),
    ],
)
def test_no_electrode_works_where_rows_are_in_another_order(order: np.ndarray, said: str) -> None:
    found = check_up(Recording(frames(None)[:, order], None), consistency())
    assert [one["state"] for one in found["electrodes"]] == [UNKNOWN] * 16
    assert not found["wiring"]["right"]
    assert lines(found)[0].startswith("No electrode can be judged: ")
    assert said in lines(found)[0]


def test_inverted_signs_are_said_and_do_no_harm() -> None:
    found = check_up(Recording(-frames(None), None), consistency())
    assert any("inverted signs" in line for line in lines(found))
    assert lines(found)[0] == "All 16 electrodes work."


def test_a_row_that_differs_from_its_reciprocal_is_reported() -> None:
    gap = np.full(104, 0.003)
    gap[(TABLE == 4).any(axis=1) | (TABLE == 3).any(axis=1)] = 0.2
    found = check_up(Recording(frames(None), gap), consistency())
    assert [one["electrode"] for one in found["electrodes"] if one["state"] == "not reciprocal"] == [4]


def test_doctor_prints_one_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    consistency()
    path = tmp_path / "recorded.npy"
    np.save(path, frames(Detached(5)))
    bundle = str(default_path("area"))
    assert main(["doctor", "--electrodes", "--recorded", str(path), "--bundle", bundle, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["electrodes"][5]["state"] == "detached"
    assert main(["doctor", "--electrodes", "--recorded", str(path), "--bundle", bundle]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("1 of 16 electrodes needs work: 5 detached.")
    assert "electrode  5  detached" in shown


COUNT_V = 1e-9

HANGING = {
    "all rows at full scale": (lambda: np.full((40, 104), (2**23 - 1) * COUNT_V), "104 of 104 rows share counts"),
    "all rows at one count, another in each frame": (
        lambda: np.outer(np.arange(1000, 1040), np.full(104, COUNT_V)),
        "104 of 104 rows share counts",
    ),
    "one frame over and over": (lambda: frames(None)[:1].repeat(40, axis=0), "all 40 frames are the same bit by bit"),
}
"""Front ends that do not live: what they send, and what is said of it."""


@pytest.mark.parametrize("hanging", HANGING)
def test_a_front_end_that_hangs_says_nothing_of_electrodes_and_is_what_is_named(
    hanging: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sends, said = HANGING[hanging]
    volts = sends()
    found = check_up(Recording(volts, None, COUNT_V), consistency())
    assert [one["state"] for one in found["electrodes"]] == [UNKNOWN] * 16
    assert {one["to_do"] for one in found["electrodes"]} == {ADVICE[UNKNOWN]}
    assert any(said in fault for fault in found["front_end"])
    path = tmp_path / "recorded.npy"
    np.save(path, volts)
    assert main(["doctor", "--electrodes", "--recorded", str(path), "--bundle", str(default_path("area"))]) == 0
    shown = capsys.readouterr().out
    assert ADVICE["well"] == "nothing to do"
    assert "nothing to do" not in shown
    assert shown.count(f"  {UNKNOWN}") == 16
    assert said in shown


@pytest.mark.parametrize("shape", [(3, 104), (40, 103), (104,)])
def test_frames_of_another_shape_are_refused(shape: tuple[int, ...], tmp_path: Path) -> None:
    path = tmp_path / "wrong.npy"
    np.save(path, np.zeros(shape))
    with pytest.raises(BadReference, match="104"):
        load_recording(path)


def test_moving_streams_name_failures_in_time_and_nothing_else() -> None:
    healthy = bench.false_alarms(consistency(), flat(), [moving()], "N2")
    assert sum(row["named"] for row in healthy) == 0
    assert sum(row["frames"] for row in healthy) == 2 * moving().frames, "104 rows and 208"
    rows = bench.detection(consistency(), flat(), [moving()], "N2", electrodes=(2, 9))
    assert {row["what"] for row in rows} == set(bench.FAILURES)
    for row in rows:
        assert row["named_in_time"] == 1.0, row


def squares(bend: Bend) -> np.ndarray:
    """Return (3, 104) log(V / V0) of 10 mm squares of the weakest contrast, in the middle of the sheet."""
    found = []
    for x in (60.0, 75.0, 90.0):
        touch = Touch((Rect(x - 5.0, 45.0, x + 5.0, 55.0),), conductivity_S_per_m=20.0)
        scene = Scene(bend=bend, touches=(touch,), element_size_mm=bench.ELEMENT_MM)
        found.append(factorise_scene(scene).voltages())
    return np.log(np.array(found) / measure(flat(), table=TABLE))


@pytest.mark.parametrize("lost", [(), (3,), (0, 9), (2, 3), (1, 6, 11)])
def test_a_stream_without_electrodes_finds_a_touch_within_five_frames(lost: tuple[int, ...]) -> None:
    arrays, rng = load_bundle(default_path("area")).gate_arrays(), np.random.default_rng(7)
    if arrays is None:
        pytest.skip("the shipped bundle has no gate; 'eitskin export' makes one")
    gate = Gate(arrays)
    gate_without_rows = GateWithoutRows(consistency(), gate, np.full(104, 0.003))
    found = []
    for touched in middle():
        gate_without_rows.leave_out(rows_of(lost))
        gate_without_rows.finish()
        shown = [np.zeros(104)] * 24 + [touched] * 5
        judged = []
        for logs in shown:
            change = (np.expm1(logs) + 0.003 * rng.standard_normal(104)).astype(np.float32)
            change[rows_of(lost)] = 7.0  # whatever a dead electrode reads
            gate_without_rows.fill(change)
            gate.change[:] = change
            judged.append(gate.touched())
        assert not any(judged[:24])
        found.append(any(judged[24:]))
    assert all(found)


@cache
def middle() -> np.ndarray:
    return squares(Bend())
