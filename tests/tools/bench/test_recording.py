"""What recorder and viewer cost: parts of a stream are told apart, and a real one holds together. No time is judged."""

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from eitskin_tools.bench.recording import bench
from eitskin_tools.bench.recording.stream import Part, Streamed, part_of
from eitskin_tools.demo.recorder import Record
from eitskin_tools.errors import UsageError

SECOND_NS = 1_000_000_000


def stream() -> Streamed:
    """Ten seconds of 100 frames each, each 1 ms old, from the fifth second on 2 ms; 3 were lost in the seventh."""
    sequence = np.setdiff1d(np.arange(1000), [610, 611, 612])
    record = Record.empty(len(sequence), (2, 2))
    record.sequence[:] = sequence
    wire_ns = np.zeros(4096, dtype=np.int64)
    wire_ns[:1000] = SECOND_NS + 10_000_000 * np.arange(1000)
    record.host_ns[:] = wire_ns[sequence][:, None] + 10_000 * np.arange(1, 8)
    record.received_ns[:] = wire_ns[sequence] + np.where(sequence < 500, 1_000_000, 2_000_000)
    used = {"run": 0.5, "pages": 0.0, "others": 1.0}
    parts = [
        Part(False, 2 * SECOND_NS, 4 * SECOND_NS, used),
        Part(True, 6 * SECOND_NS, 8 * SECOND_NS, used | {"record": 0.1}, pictures=60, recorder=said(200)),
        Part(True, 9 * SECOND_NS, 10 * SECOND_NS, used | {"record": 0.1}, pictures=30, recorder=said(100)),
    ]
    return Streamed(parts, record, wire_ns, {}, [])


def said(frames: int) -> dict[str, int]:
    return {"frames": frames, "missed": 1, "dropped": 0, "bytes": 1000}


def test_frames_belong_to_the_part_in_which_they_went_onto_the_wire() -> None:
    found = stream()
    assert part_of(found, found.parts[0]).sequence.tolist() == list(range(100, 300))
    with pytest.raises(ValueError, match="not one frame came within 1 s"):
        part_of(found, Part(False, 0, SECOND_NS, {}))


def test_a_case_is_all_its_parts_and_nothing_between_them() -> None:
    found = stream()
    alone, beside = bench.case(found, 1, beside=False), bench.case(found, 1, beside=True)
    assert (alone["frames"], alone["lost"], alone["latency_us"]["p50"]) == (200, 0, 1000.0)
    assert (beside["frames"], beside["lost"], beside["latency_us"]["p99"]) == (297, 3, 2000.0)  # not those between
    assert beside["seconds"] == 3.0
    assert beside["recorder"] == {"frames": 300, "missed": 2, "dropped": 0, "bytes": 2000}
    assert beside["pictures_a_page_s"] == 30.0
    assert beside["core_percent"]["record"] == pytest.approx(6.67)
    assert alone["runtime_cpu_us_a_frame"] == 2500.0


def test_what_reinfer_said_of_several_files_is_added_up() -> None:
    one = {"frames": 10, "withheld": 0, "published": 9, "equal": 8, "unknown": 1, "recorded_s": 2.0, "elapsed_s": 0.1,
           "cpu_s": 0.05, "differing": {"map": 1}, "unknown_why": {"before_file": 1}}  # fmt: skip
    found = bench.summed([one, one | {"equal": 9, "differing": {}}])
    assert (found["unknown"], found["unknown_why"]) == (2, {"before_file": 2})
    assert (found["published"], found["equal"], found["differing"]) == (18, 17, 1)
    assert (found["times_real_time"], found["times_real_time_cpu"]) == (20.0, 40.0)


@pytest.mark.parametrize(
    "wrong", [["--seconds", "0"], ["--rounds", "0"], ["--rate", "2000"], ["--pages", "0"], ["--pages", "99"]]
)
def test_wrong_options_are_bad_usage(wrong: list[str]) -> None:
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    with pytest.raises(UsageError, match=wrong[0]):
        bench.run(parser.parse_args(wrong))


@pytest.mark.process
@pytest.mark.slow
def test_a_short_stream_is_recorded_looked_at_and_computed_again(capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    assert (
        bench.run(parser.parse_args(["--seconds", "2", "--rounds", "1", "--rate", "50", "--pages", "2", "--json"])) == 0
    )
    found = json.loads(capsys.readouterr().out)
    for name in bench.CASES.values():
        assert found[name]["frames"] > 0
        assert found[name]["core_percent"]["run"] > 0
    assert set(found["alone"]["core_percent"]) | {"record", "view"} == set(found["beside"]["core_percent"])
    assert set(found["ratios"]) == {"p50", "p99"}
    again, kept = found["reinfer"], found["beside"]["recorder"]
    assert kept["missed"] == again["differing"] == 0
    assert again["frames"] == kept["frames"] > 0
    assert again["equal"] + again["unknown"] == again["published"] > 0


def test_the_rounds_begin_with_one_and_the_other_in_turn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seen: list[bool] = []

    class Enough(Exception):
        pass

    def streamed(order: list[bool], *_: object) -> None:
        seen.extend(order)
        raise Enough

    monkeypatch.setattr("eitskin_tools.bench.recording.stream.streamed", streamed)
    with pytest.raises(Enough):
        bench.measure(1.0, 3, 50.0, 1)
    assert seen == [False, True, True, False, False, True]
