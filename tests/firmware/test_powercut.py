import json

import pytest
from tests.faults import powercut


@pytest.mark.parametrize("kind", powercut.KINDS)
def test_a_power_cut_at_any_change_of_storage_leaves_the_old_or_the_new_configuration(core, kind):
    # Seed 0 cuts just before the change, 1 just after it, erasing downwards; 4 tears the word and erases upwards.
    seeds = (0, 1) if kind == "rollback" else (1, 4)
    changes = powercut.count_changes(kind)
    assert changes >= (1 if kind == "rollback" else 40)
    booted = {powercut.cut_once(kind, change, seed) for change in range(1, changes + 1) for seed in seeds}
    assert len(booted) == 2, "some cuts come too early and some too late: both outcomes must have been seen"


@pytest.mark.heavy
def test_the_last_line_tells_of_writes_and_of_sequences(core, capsys):
    assert powercut.main(["--seeds", "1", "--no-board", "--sequences", "60"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["lost"] == 0
    assert {"cut_points", "cuts", "booted", "lost"} == set(found["powercut"]["model"])
    assert (found["powercut"]["sequences"]["sequences"], found["powercut"]["sequences"]["breaches"]) == (60, 0)
    assert found["powercut"]["board"] == "not run"
