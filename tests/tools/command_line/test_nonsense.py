"""Options that are no numbers, or that would do nothing, are bad usage and one line."""

import pytest

from eitskin_tools import cli


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("virtual-skin --snr-db nan", "--snr-db is nan, expected 0 to 200"),
        ("virtual-skin --snr-db=-1e9", "--snr-db is -1e+09"),
        ("virtual-skin --seed -1", "--seed is -1, expected 0 to 1000000000"),
        ("virtual-skin --scene sample --touches lower", "those of --scene are as it says"),
        ("demo --no-draw --seed -3", "--seed is -3, expected 0 to 1000000000"),
        ("run --port /dev/null --reference flat.json --force-reference", "--force-reference is of a reference that"),
        (
            "run --port /dev/null --reference flat.json --reference-frames 9",
            "--reference-frames is of a reference that",
        ),
        ("train --recipe tiny --data d --out o --seed -1", "--seed is -1, expected 0 to 1000000000"),
        ("adapt r --out o --seed 99999999999999", "--seed is 99999999999999, expected 0 to 1000000000"),
        (
            "adapt-skin press --skin lab --out o.eitskin --seed 99999999999999",
            "--seed is 99999999999999, expected 0 to 1000000000",
        ),
        ("calibrate r.npz --out s.toml --bends 0", "without --guided nothing is recorded now: leave --bends out"),
        ("calibrate r.npz --out s.toml --full-scan --stamp 16", "leave --full-scan, --stamp out"),
    ],
)
def test_it_is_said_before_anything_is_done(words: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1
