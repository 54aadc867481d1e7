"""The studies: each says what it takes, refuses wrong options, and counts what it says it counts. No time is judged."""

import pytest

from eitskin_tools.bench.harness import program

from .study import FOLDER, study

NAMES = sorted(path.stem for path in FOLDER.glob("*.py"))


@pytest.mark.parametrize("name", NAMES)
def test_a_study_says_what_it_takes(name, capsys):
    module = study(name)
    with pytest.raises(SystemExit) as ended:
        program(module.__doc__, module.add_arguments, module.run, ["--help"])
    assert ended.value.code == 0
    assert "--json" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("skins", "--counts=x"), ("taught_shapes", "--presses=5")],
)
def test_a_wrong_option_is_one_line_and_bad_usage(name, wrong, capsys):
    module = study(name)
    assert program(module.__doc__, module.add_arguments, module.run, [wrong]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert wrong.partition("=")[0] in line
