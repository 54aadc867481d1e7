import numpy as np
import pytest

import eitskin
from eitskin.model.buffers import Buffers
from eitskin.model.engine import default_solver, engines
from eitskin.model.geometry import GeometryGraph
from eitskin_proto.sensor.table import FULL_TABLE, N_FULL_ROWS, N_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL

REFERENCE = np.linspace(-2.0, -0.1, N_ROWS)


@pytest.fixture
def voltages():
    """Return five untouched frames, and one in which all rows changed by as much as a hand makes."""
    rng = np.random.default_rng(3)
    frames = REFERENCE * (1 + 1e-4 * rng.standard_normal((6, N_ROWS)))
    frames[5] *= rng.uniform(0.2, 0.9, N_ROWS)
    return frames


def test_maps_are_those_of_the_stream_s_own_engine_and_0_where_the_gate_is_shut(tiny, voltages):
    found = eitskin.reconstruct(voltages, REFERENCE, tiny)
    assert found.map.shape == (6, 30, 45)
    assert found.map.dtype == np.float32
    assert found.touched.tolist() == [False] * 5 + [True]
    assert not found.map[:5].any()
    buffers = Buffers(tiny)
    buffers.use_geometry(GeometryGraph(tiny).geometry(None, None, 0))
    buffers.change[0] = voltages[5] / REFERENCE - 1
    (engine,) = engines(tiny, buffers, best=default_solver(tiny), alone=True)
    engine.infer()
    assert found.solver == engine.name
    assert np.array_equal(found.map[5].ravel(), buffers.map[0])


def test_a_frame_alone_and_all_208_rows_give_the_same_map(tiny, voltages):
    full, reference = np.zeros((2, N_FULL_ROWS))
    for rows in (ROW_IN_FULL, RECIPROCAL_IN_FULL):
        full[rows], reference[rows] = voltages[5], REFERENCE
    alone = eitskin.reconstruct(voltages[5], REFERENCE, tiny)
    assert alone.map.shape == (1, 30, 45)
    assert np.array_equal(eitskin.reconstruct(full, reference, tiny).map, alone.map)


def test_amounts_have_no_sign_that_a_table_could_change(tiny, voltages):
    table = FULL_TABLE.astype(int)[:, [0, 0, 1, 1]]
    table[:, [1, 3]] = (table[:, [1, 3]] + 1) % 16
    table[::3] = table[::3][:, [0, 1, 3, 2]]
    full, reference = np.zeros((2, N_FULL_ROWS))
    for rows in (ROW_IN_FULL, RECIPROCAL_IN_FULL):
        full[rows], reference[rows] = np.abs(voltages[5]), np.abs(REFERENCE)
    found = eitskin.reconstruct(full, reference, tiny, table=table)
    assert np.array_equal(found.map, eitskin.reconstruct(voltages[5], REFERENCE, tiny).map)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v, r: (v[:, :50], r), r"shape \(6, 50\) and the reference \(104,\); expected"),
        (lambda v, r: (np.where(v == v[2, 7], np.nan, v), r), r"voltages at \[2, 7\] is not finite"),
        (lambda v, r: (v, np.where(r == r[3], np.inf, r)), r"the reference at \[3\] is not finite"),
        (lambda v, r: (0 * v, r), "frame 0 have no signal"),
        (lambda v, r: (1e9 * v, r), "frame 0 are too far from the reference"),
        (lambda v, r: (v[:, :90], r[:90]), "90 rows of an unknown protocol; take a bundle of these rows"),
        (lambda v, r: (v, 0 * r), "a reference of zeros cannot normalise frames"),
        (lambda v, r: ([["a"]], r), "real numbers"),
        (lambda v, r: (v * 1j, r * 1j), "complex, expected real numbers"),
    ],
)  # fmt: skip
def test_what_cannot_be_voltages_is_refused_in_a_line(tiny, voltages, change, message):
    with pytest.raises(ValueError, match=message) as raised:
        eitskin.reconstruct(*change(voltages, REFERENCE), tiny)
    assert "\n" not in str(raised.value)
