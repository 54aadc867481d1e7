import numpy as np

from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.table import (
    FULL_TABLE,
    N_ROWS,
    RECIPROCAL_IN_FULL,
    ROW_IN_FULL,
    TABLE,
    voltages_from_potentials,
)
from eitskin_proto.skin.skin import PAPER


def test_the_table_has_104_rows_in_13_13_12_to_1_a_drive():
    assert N_ROWS == len(TABLE) == 104
    assert np.bincount(TABLE[:, 0], minlength=16).tolist() == [13, 13, *range(12, 0, -1), 0, 0]
    assert np.bincount(FULL_TABLE[:, 0]).tolist() == [13] * 16


def test_no_measured_pair_shares_an_electrode_with_the_drive_and_every_other_pair_is_there():
    expected = {(k, m) for k in range(16) for m in range(16) if not {k, (k + 1) % 16} & {m, (m + 1) % 16}}
    assert {tuple(row) for row in FULL_TABLE.tolist()} == expected
    assert len(FULL_TABLE) == len(expected) == 208


def test_the_order_is_drive_then_measure_ascending():
    assert TABLE.tolist() == sorted(TABLE.tolist())
    assert TABLE[:3].tolist() == [[0, 2], [0, 3], [0, 4]]
    assert FULL_TABLE[13 * 2 + 12].tolist() == [2, 0]  # measures go round: 2 .. 15, then 0


def test_reciprocal_rows_swap_drive_and_measure_and_cover_the_rest():
    assert np.array_equal(FULL_TABLE[RECIPROCAL_IN_FULL], TABLE[:, ::-1])
    assert sorted([*ROW_IN_FULL.tolist(), *RECIPROCAL_IN_FULL.tolist()]) == list(range(208))


def test_a_reciprocal_network_gives_equal_voltages_and_a_non_reciprocal_one_does_not():
    # Potentials U = Z I of any symmetric Z under the adjacent drives I: V(k, m) = V(m, k) exactly, up to rounding.
    rng = np.random.default_rng(0)
    impedance = rng.normal(size=(16, 16))
    drives = np.eye(16) - np.roll(np.eye(16), 1, axis=1)
    for matrix, reciprocal in ((impedance + impedance.T, True), (impedance, False)):
        full = voltages_from_potentials(drives @ matrix.T, FULL_TABLE)
        assert np.allclose(full[ROW_IN_FULL], full[RECIPROCAL_IN_FULL], rtol=1e-12, atol=1e-12) == reciprocal
        assert np.array_equal(voltages_from_potentials(drives @ matrix.T), full[ROW_IN_FULL])


def test_a_voltage_is_the_measured_electrode_minus_the_next():
    potentials = np.zeros((16, 16))
    potentials[3, 7], potentials[3, 8] = 5.0, 2.0
    row = TABLE.tolist().index([3, 7])
    assert voltages_from_potentials(potentials)[row] == 3.0


def test_electrodes_are_even_and_mirror_symmetric():
    assert np.allclose(np.diff(PAPER.arc_length_mm), 31.25, rtol=1e-14)
    # Mirrored in x, arc length s goes to 150 - s modulo the border's 500 mm.
    assert sorted(np.round((150 - PAPER.arc_length_mm) % 500, 9)) == sorted(np.round(PAPER.arc_length_mm, 9))
    per_side = np.histogram(PAPER.arc_length_mm, bins=[0, 150, 250, 400, 500])[0]
    assert per_side.tolist() == [5, 3, 5, 3]


def test_the_ids_are_those_of_every_artefact_made_so_far():
    # A change here means that bundles, data sets, references and firmware made before are refused: be sure of it.
    assert (PROTOCOL_ID, PAPER.grid_id) == ("0bff7f6e45fa7bc8", "ef41b0aa6e17eb61")
