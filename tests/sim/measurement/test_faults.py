"""Failing electrodes as circuits: closed forms, symmetry, and the forward model with one contact worn out."""

from functools import cache

import numpy as np
import pytest

from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import FULL_TABLE, RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_sim.fem.forward import Factor, System, assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.measurement import faults
from eitskin_sim.measurement.faults import Detached, Noisy, Shorted, Swapped, measure, response_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Electrodes, Scene, Sheet


@pytest.fixture
def ideal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Electronics that no load disturbs."""
    monkeypatch.setattr(faults, "COMPLIANCE_OHM", np.inf)
    monkeypatch.setattr(faults, "INPUT_OHM", np.inf)


@cache
def coarse() -> System:
    scene = Scene(element_size_mm=4.5)
    return assemble(scene_mesh(scene), Sheet(), Electrodes(), bend_metric(scene.bend, scene.sheet))


@cache
def healthy() -> np.ndarray:
    return response_of(coarse().factorise())


def of_pair(electrode: int, table: np.ndarray = FULL_TABLE) -> np.ndarray:
    return np.asarray((table == electrode).any(axis=1))


def test_without_a_fault_the_rows_are_those_of_the_forward_model() -> None:
    direct = coarse().factorise().voltages(FULL_TABLE)
    # The weakest row is 500 times smaller than the largest, and is a difference of potentials here.
    np.testing.assert_allclose(measure(healthy()), direct, atol=1e-10 * np.abs(direct).max())


@pytest.mark.usefixtures("ideal")
def test_a_series_resistance_is_invisible_to_ideal_electronics() -> None:
    worn = measure(healthy(), (Detached(4, 1e6),))
    np.testing.assert_allclose(worn, measure(healthy()), atol=1e-7 * np.abs(worn).max())


def test_a_series_resistance_stops_a_real_source_and_lets_a_wire_float() -> None:
    real, before = measure(healthy(), (Detached(4, 1e6),)), measure(healthy())
    driven, sensed = np.isin(FULL_TABLE[:, 0], (3, 4)), np.isin(FULL_TABLE[:, 1], (3, 4))
    assert np.abs(real[driven]).max() < 0.01 * np.abs(before[driven]).max()  # the source is at its compliance
    assert np.median(np.abs(real[sensed])) > 2.0 * np.median(
        np.abs(before[sensed])
    )  # a floating wire is near mid potential


@pytest.mark.usefixtures("ideal")
def test_a_worn_contact_of_the_forward_model_is_a_series_resistance() -> None:
    system, factor = coarse(), 1e3
    sigma = np.full(system.mesh.n_elements, system.background)
    density = system.contacts.density(sigma[system.contacts.element])
    density[system.contacts.electrode == 4] /= factor
    worn = Factor(system, sigma[:, None, None] * system.stiffness, density).voltages(FULL_TABLE)
    circuit = measure(healthy(), (Detached(4, factor),))
    # A worn contact also stops shunting the current below it, which a resistance in its wire does not show: 2 % of the
    # rows beside it, nothing elsewhere.
    apart = ~(of_pair(3) | of_pair(4))
    np.testing.assert_allclose(worn[apart], circuit[apart], rtol=5e-3, atol=2e-4 * np.abs(worn).max())
    np.testing.assert_allclose(worn, circuit, rtol=0.05, atol=5e-3 * np.abs(worn).max())


def test_a_short_equals_the_textbook_with_a_current_between_the_wires() -> None:
    ohm, drive, sense = healthy(), 2, 11
    current, short = np.zeros(16), np.zeros(16)
    current[[drive, drive + 1]], short[[7, 8]] = (1.0, -1.0), (1.0, -1.0)
    through = -(short @ ohm @ current) / (short @ ohm @ short + 0.1)
    potential = ohm @ (current + through * short)
    row = int(np.flatnonzero(((drive, sense) == FULL_TABLE).all(axis=1))[0])
    found = measure(ohm, (Shorted(7, 8),))[row]
    assert found == pytest.approx(potential[sense] - potential[sense + 1], rel=1e-9)


@pytest.mark.parametrize("fault", [Shorted(3, 4), Swapped(2, 9)])
def test_reciprocity_survives_passive_faults(fault: Shorted | Swapped) -> None:
    rows = measure(healthy(), (fault,))
    np.testing.assert_allclose(rows[ROW_IN_FULL], rows[RECIPROCAL_IN_FULL], atol=1e-9 * np.abs(rows).max())


def test_reciprocity_breaks_at_a_detached_electrode_and_nowhere_else() -> None:
    rows = measure(healthy(), (Detached(5),))
    gap = np.abs(rows[ROW_IN_FULL] - rows[RECIPROCAL_IN_FULL]) / np.abs(rows).max()
    involved = rows_of((5,))
    assert gap[~involved].max() < 1e-9
    assert np.median(gap[involved]) > 1e-3


@pytest.mark.parametrize("fault", [Detached(16), Shorted(3, 3), Swapped(-1, 2), Noisy(4)])
def test_a_fault_that_makes_no_sense_is_refused(fault: object) -> None:
    with pytest.raises(ValueError, match=r"electrodes|rng"):
        measure(healthy(), (fault,))  # type: ignore[arg-type]
