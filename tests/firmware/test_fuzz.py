import json

from tests.faults import fuzz


def test_mutated_frames_are_never_accepted_and_intact_ones_never_lost(core, capsys):
    assert fuzz.main(["--frames", "10000", "--seed", "3", "--guided-seconds", "0"]) == 0
    report = json.loads(capsys.readouterr().out)
    figures = report["fuzz"]["stream"]
    assert figures["sent"] == 10_000
    assert 4_000 < figures["mutated"] < 6_000
    assert 3_500 < figures["intact"] <= figures["accepted"]
    assert report["fuzz"]["behind_the_check"]["accepted"] > 100, "some damage must be harmless, or nothing was compared"
    assert report["wrong"] == 0
