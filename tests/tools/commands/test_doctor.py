"""``eitskin doctor``: what does nothing where it stands is refused."""

import pytest

from eitskin_tools import cli


@pytest.mark.parametrize("words", [["--recorded", "f.npy"], ["--reference", "r.json"], ["--bundle", "free"]])
def test_what_only_a_look_at_electrodes_or_drift_needs_is_not_ignored(words, capsys):
    assert cli.main(["doctor", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == f"eitskin doctor: {words[0]} does nothing alone: say --electrodes or --drift, what to look for\n"
