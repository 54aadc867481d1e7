"""Front ends as circuits: ladders of resistors in closed form, Kirchhoff's law, and what breaks reciprocity."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from eitskin_proto.sensor.table import FULL_TABLE, RECIPROCAL_IN_FULL, ROW_IN_FULL, TABLE
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.measurement.faults import response_of
from eitskin_sim.measurement.front_end import FrontEnd, to_voltages
from eitskin_sim.scene.parts import Scene

UNEVEN = tuple(float(s) for s in np.linspace(1e-4, 4e-4, 16))
"""Stray conductances, S."""


def ring(ohms: np.ndarray) -> np.ndarray:
    """Return the (16, 16) S admittance of resistors from each terminal to the next, round the ring."""
    found = np.zeros((16, 16))
    for k, ohm in enumerate(ohms):
        a, b = k, (k + 1) % 16
        found[[a, b], [a, b]] += 1.0 / ohm
        found[[a, b], [b, a]] -= 1.0 / ohm
    return found


def random_sheet(seed: int = 0) -> np.ndarray:
    """Return the admittance of resistors between all terminals."""
    rng = np.random.default_rng(seed)
    between = np.triu(rng.uniform(1e-4, 1e-2, (16, 16)), 1)
    between = between + between.T
    return np.asarray(np.diag(between.sum(axis=1)) - between)


def response(admittance: np.ndarray) -> np.ndarray:
    """Return R with terminal 15 at zero, the way that a solver grounds it."""
    found = np.zeros((16, 16))
    found[:15, :15] = np.linalg.inv(admittance[:15, :15])
    return found


@cache
def sheet() -> np.ndarray:
    return response_of(factorise_scene(Scene(element_size_mm=4.5)))


def naive(admittance: np.ndarray, stray: np.ndarray, ratio: float, k: int) -> np.ndarray:
    """Return the (16,) potentials of one drive by Kirchhoff's law at every terminal."""
    currents = np.zeros(16)
    currents[k], currents[(k + 1) % 16] = 1.0, -ratio
    return np.asarray(np.linalg.solve(admittance + np.diag(stray), currents))


def test_an_ideal_front_end_reads_the_rows_of_the_generators_to_the_last_bit() -> None:
    many = np.stack([sheet(), response(random_sheet())])
    np.testing.assert_array_equal(FrontEnd().read(many), to_voltages(many))
    np.testing.assert_array_equal(FrontEnd().read(many, FULL_TABLE)[:, ROW_IN_FULL], FrontEnd().read(many))


def test_a_ring_of_resistors_with_every_terminal_but_one_floating_is_a_ladder() -> None:
    # The stray of terminal 5 alone carries what the sink leaves, so 5 is at (1 - q) / s; the ring is a divider.
    ohms, stray, ratio = np.linspace(1.0, 4.0, 16), 2e-3, 0.7
    front = FrontEnd(stray_S=tuple(stray if k == 5 else 0.0 for k in range(16)), sink_share=ratio)
    found = front.potentials(response(ring(ohms)))[9]  # 1 A into 9, 0.7 out of 10, 0.3 out of 5 by its stray
    assert found[5] == pytest.approx((1.0 - ratio) / stray, rel=1e-12)
    whole, short, way = ohms.sum(), ohms[9], ohms[5:9].sum()
    steps = np.full(16, 0.0)  # the currents through resistors k, from k to k + 1, by superposition of two sources
    steps += np.where(np.arange(16) == 9, ratio * (whole - short) / whole, -ratio * short / whole)
    inner = np.isin(np.arange(16), np.arange(5, 9))
    steps += np.where(inner, -(1.0 - ratio) * (whole - way) / whole, (1.0 - ratio) * way / whole)
    np.testing.assert_allclose(found - np.roll(found, -1), steps * ohms, rtol=1e-9)


@pytest.mark.parametrize("ratio", [1.0, 0.8])
def test_every_drive_obeys_kirchhoffs_law(ratio: float) -> None:
    admittance, stray = random_sheet(), np.array(UNEVEN)
    found = FrontEnd(stray_S=UNEVEN, sink_share=ratio).potentials(response(admittance))
    for k in range(16):
        np.testing.assert_allclose(found[k], naive(admittance, stray, ratio, k), rtol=1e-10, atol=1e-12)


def test_gains_offsets_and_the_divided_current_are_what_they_say() -> None:
    gain, pair = (tuple(np.random.default_rng(n).uniform(0.9, 1.1, 16).tolist()) for n in range(2))
    ideal, m = FrontEnd().read(sheet(), FULL_TABLE), FULL_TABLE[:, 1]
    found = FrontEnd(gain, pair).read(sheet(), FULL_TABLE, current_A=2.0)
    np.testing.assert_allclose(found, 2.0 * np.array(gain)[m] * ideal + np.array(pair)[m], rtol=1e-9)
    plain = FrontEnd(stray_S=1e-4, sink_share=0.8).read(sheet())
    divided = FrontEnd(stray_S=1e-4, sink_share=0.8, normalised=True).read(sheet())
    np.testing.assert_allclose(divided, plain / 0.8, rtol=1e-12)


def test_a_weaker_minus_path_adds_its_share_of_the_minus_potential() -> None:
    even = FrontEnd(stray_S=UNEVEN)
    uneven = FrontEnd(stray_S=UNEVEN, minus_gain=0.98)
    potentials = even.potentials(sheet()).real
    minus = np.array([potentials[k, (m + 1) % 16] for k, m in TABLE])
    np.testing.assert_allclose(uneven.read(sheet()) - even.read(sheet()), 0.02 * minus, rtol=1e-6)


def test_strays_keep_reciprocity_and_a_sink_or_paths_of_its_own_break_it_as_the_circuit_says() -> None:
    def swapped(front: FrontEnd) -> np.ndarray:
        full = front.read(sheet(), FULL_TABLE)
        return np.asarray(full[ROW_IN_FULL] - full[RECIPROCAL_IN_FULL])

    scale = np.abs(FrontEnd().read(sheet())).max()
    assert np.abs(swapped(FrontEnd(stray_S=UNEVEN))).max() < 1e-10 * scale  # Y + diag(s) is symmetric still
    # V[k, m] - V[m, k] = (1 - q) (Z[m, k+1] - Z[m+1, k+1] - Z[k, m+1] + Z[k+1, m+1]),   Z = (Y + diag s)^-1
    admittance = np.linalg.pinv(sheet() - sheet().mean(0) - sheet().mean(1)[:, None] + sheet().mean(), hermitian=True)
    whole = np.linalg.inv(admittance + np.diag(UNEVEN))
    k, m = TABLE.astype(int).T
    next_k, next_m = (k + 1) % 16, (m + 1) % 16
    leak = whole[m, next_k] - whole[next_m, next_k] - whole[k, next_m] + whole[next_k, next_m]
    found = swapped(FrontEnd(stray_S=UNEVEN, sink_share=0.9))
    np.testing.assert_allclose(found, 0.1 * leak, atol=1e-9 * scale)
    assert np.abs(found).max() > 1e-4 * scale
    # q = 1, unequal paths p, n:  V[k, m] - V[m, k] = (p - n) (Z[m, k] - Z[k, m] - Z[m, k+1] + Z[k, m+1]) and its mirror
    path = whole[k, next_m] - whole[m, next_k]
    uneven = FrontEnd(stray_S=UNEVEN, minus_gain=0.96)
    np.testing.assert_allclose(swapped(uneven), 0.04 * path, atol=1e-9 * scale)


def disc() -> np.ndarray:
    """Return the response of a disc of 2 mS: -log(2 sin(a / 2)) / (pi 2 mS) at an angle a, and contacts of 1 kohm."""
    apart = np.abs(np.subtract.outer(np.arange(16), np.arange(16))) * np.pi / 16
    found = -np.log(2.0 * np.sin(apart + np.eye(16) * 0.05)) / (np.pi * 2e-3)
    return np.asarray(found + 1e3 * np.eye(16))


@pytest.mark.parametrize(
    ("front", "says"),
    [
        ({"gain": (1.0, 2.0)}, "gain has 2 numbers; it must be one, or 16"),
        ({"stray_S": -1e-4}, "negative part"),
        ({"minus_gain": float("nan")}, "not finite"),
        ({"stray_S": 1e-4, "sink_share": 0.0, "normalised": True}, "sink_share falls to 0"),
    ],
)
def test_a_front_end_that_cannot_be_is_refused(front: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        FrontEnd(**front)
