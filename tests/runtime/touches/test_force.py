"""A user's table: linear between its loads, silent beyond them, and refused by name where it is none."""

import pytest

import eitskin

GOOD = "strength,newtons,newtons_error\n0,0,0.1\n10,2,0.3\n30,3,0.3\n"


@pytest.fixture
def table(tmp_path):
    (tmp_path / "mine.csv").write_text(GOOD)
    return eitskin.ForceTable.load(tmp_path / "mine.csv")


def test_between_two_loads_it_is_linear_and_errors_add_up(table):
    assert table.newtons(10.0) == pytest.approx((2.0, 0.3))
    assert table.newtons(5.0) == pytest.approx((1.0, 0.2))
    assert table.newtons(20.0, error=8.0) == pytest.approx((2.5, 0.5))  # 0.3 of the table, 8 * 0.05 of the strength
    assert table.newtons(0.0) == pytest.approx((0.0, 0.1))
    assert table.newtons(30.0) == pytest.approx((3.0, 0.3))


@pytest.mark.parametrize("strength", [None, -0.1, 30.1, float("nan")])
def test_it_says_nothing_of_what_was_not_measured(table, strength):
    assert table.newtons(strength) is None


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("strength,N\n1,2\n", "found columns strength, N, expected strength, newtons, newtons_error"),
        ("", "found columns none"),
        (GOOD + "40,x,1\n", "line 5 is 40,x,1, expected three numbers"),
        (GOOD + "40,1\n", "line 5 is 40,1, expected three numbers"),
        (GOOD + "30,4,1\n", "load 4 has strength 30 after 30, expected rising"),
        (GOOD + "50,4,-1\n", "load 4 is"),
        (GOOD + "50,inf,1\n", "load 4 is"),
        ("strength,newtons,newtons_error\n1,2,3\n", "found 1 loads, expected at least 2"),
    ],
)
def test_what_is_no_table_is_refused_in_a_line(tmp_path, text, named):
    path = tmp_path / "mine.csv"
    path.write_text(text)
    with pytest.raises(eitskin.CalibrationError, match=named) as caught:
        eitskin.ForceTable.load(path)
    assert "mine.csv" in str(caught.value)
    assert "\n" not in str(caught.value)
