"""The studies: each says what it takes, refuses wrong options, and counts what it says it counts. No time is judged."""

import numpy as np
import pytest

from eitskin_tools.bench.harness import program
from eitskin_tools.demo.recorder import Record

from .study import FOLDER, study

NAMES = sorted(path.stem for path in FOLDER.glob("*.py"))
SECOND_NS = 1_000_000_000


@pytest.mark.parametrize("name", NAMES)
def test_a_study_says_what_it_takes(name, capsys):
    module = study(name)
    with pytest.raises(SystemExit) as ended:
        program(module.__doc__, module.add_arguments, module.run, ["--help"])
    assert ended.value.code == 0
    assert "--json" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("memory", "--seconds=0"), ("recording", "--pages=99"), ("skins", "--counts=x"), ("surface", "--points=2"),
     ("touches", "--frames=5"), ("verified_stream", "--frames=5")],
)  # fmt: skip
def test_a_wrong_option_is_one_line_and_bad_usage(name, wrong, capsys):
    module = study(name)
    assert program(module.__doc__, module.add_arguments, module.run, [wrong]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert wrong.partition("=")[0] in line


def test_skins_without_loss_are_counted_below_the_first_loss_and_not_on_a_busy_machine():
    def row(what, skins, us, lost=0, others=10):
        return {"what": what, "skins": skins, "lost": lost, "withheld": 0, "not_taken": 0, "cpu_us_a_frame": us,
                "others_core_percent": others}  # fmt: skip

    rows = [row("untouched", 1, 100), row("untouched", 2, 110), row("untouched", 4, 120)]
    rows += [row("touched", 1, 300), row("touched", 2, 330, lost=1), row("touched", 4, 360)]
    found = study("skins").summary(rows, 2)
    assert (found["untouched_most_without_loss"], found["touched_most_without_loss"]) == (4, 1)
    assert found["touched_to_untouched"] == 3.0
    busy = study("skins").summary([*rows, row("touched", 8, 300, others=51)], 2)
    assert busy["untouched_most_without_loss"] is None
    assert "is not concluded" in busy["not_concluded"]


def test_a_part_of_a_recorded_stream_is_what_went_onto_the_wire_in_it():
    recording = study("recording")
    sequence = np.setdiff1d(np.arange(1000), [610, 611, 612])
    record, wire_ns = Record.empty(len(sequence), (2, 2)), np.zeros(4096, dtype=np.int64)
    record.sequence[:] = sequence
    wire_ns[:1000] = SECOND_NS + 10_000_000 * np.arange(1000)
    record.host_ns[:] = wire_ns[sequence][:, None] + 10_000 * np.arange(1, 8)
    record.received_ns[:] = wire_ns[sequence] + np.where(sequence < 500, 1_000_000, 2_000_000)
    used, kept = {"run": 0.5}, {"frames": 200, "missed": 1, "dropped": 0, "bytes": 1000}
    parts = [
        recording.Part(False, 2 * SECOND_NS, 4 * SECOND_NS, used),
        recording.Part(True, 6 * SECOND_NS, 8 * SECOND_NS, used, pictures=60, recorder=kept),
    ]
    stream = recording.Streamed(parts, record, wire_ns, {}, [])
    alone, beside = (recording.case(stream, 1, beside=which) for which in (False, True))
    assert (alone["frames"], alone["lost"], alone["latency_us"]["p50"]) == (200, 0, 1000.0)
    assert (beside["frames"], beside["lost"], beside["latency_us"]["p99"]) == (197, 3, 2000.0)
    assert beside["pictures_a_page_s"] == 30.0
