"""Tables of rows: their names, their check, and what one gives of another."""

import numpy as np
import pytest

from eitskin_proto.sensor.row_table import ADJACENT_104, RowTable, named, numbered, row_map
from eitskin_proto.sensor.table import FULL_TABLE, TABLE


def _scan(table: RowTable, seed: int = 0) -> np.ndarray:
    """Return the voltages of a table on a resistor network, which is reciprocal by its symmetry."""
    root = np.random.default_rng(seed).standard_normal((32, 32))
    transfer = root @ root.T
    a, b, m, n = table.electrodes.astype(int).T
    return transfer[m, a] - transfer[m, b] - transfer[n, a] + transfer[n, b]


def test_the_projects_tables_are_the_named_ones() -> None:
    assert np.array_equal(ADJACENT_104.electrodes[:, ::2], TABLE)
    assert np.array_equal(named("adjacent-208").electrodes[:, ::2], FULL_TABLE)
    assert [named(name).rows for name in ("opposite-192", "adjacent-40", "adjacent-928", "rows-7")] == [192, 40, 928, 7]


@pytest.mark.parametrize(("name", "parser"), [("pyeit-208", "std"), ("eidors-208", "rotate_meas")])
def test_pyeits_orders_are_pyeits(name: str, parser: str) -> None:
    protocol = pytest.importorskip("pyeit.eit.protocol", reason="pyEIT is not installed").create(16, 1, 1, parser)
    rows = [(*drive, *pair) for drive, pairs in zip(protocol.ex_mat, protocol.meas_mat, strict=True) for pair in pairs]
    assert np.array_equal(named(name).electrodes, rows)


@pytest.mark.parametrize("source", ["adjacent-208", "pyeit-208", "eidors-208", "adjacent-104"])
def test_each_order_of_adjacent_rows_gives_the_projects(source: str) -> None:
    found, mapped = np.zeros(104), row_map(named(source), ADJACENT_104)
    if mapped is None:
        found[:] = _scan(named(source))
    else:
        mapped.apply(_scan(named(source)), found)
    np.testing.assert_allclose(found, _scan(ADJACENT_104), rtol=1e-12)


def test_rows_that_are_not_there_are_refused() -> None:
    with pytest.raises(ValueError, match="104 of 104 rows are measured neither directly"):
        row_map(named("opposite-192"), ADJACENT_104)
    with pytest.raises(ValueError, match="unknown protocol"):
        row_map(numbered(208), ADJACENT_104)
    assert row_map(numbered(104), ADJACENT_104) is None  # as many rows, of which nothing else is known


@pytest.mark.parametrize(
    ("electrodes", "expected"),
    [
        ([[0, 1, 2]], r"shape \(1, 3\), expected \(rows, 4\)"),
        ([[0, 1, 2, 40]], "electrodes 0 to 40, expected 0 to at least 7 and at most 31"),
        ([[0, 0, 2, 9]], "row 0 is .* expected two electrodes a pair"),
        ([[0, 1, 2, 9], [0, 1, 2, 9]], "twice"),
        ([[0, 1.5, 2, 9]], "not whole"),
    ],
)
def test_what_is_no_table_is_refused_with_what_was_found(electrodes: list, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        RowTable.of(electrodes)


def test_tables_are_known_by_their_rows_and_not_by_their_name() -> None:
    again = RowTable.of(ADJACENT_104.electrodes, "mine")
    assert again.id == ADJACENT_104.id != named("adjacent-208").id
    with pytest.raises(ValueError, match="no table of rows is called 'adjacent-105'"):
        named("adjacent-105")
