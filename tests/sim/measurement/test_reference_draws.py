"""What is asked of a captured reference, on solved sheets: honest ones pass, touched ones never, bent ones seldom."""

from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.errors import BadReference
from eitskin.model.bundle import load_bundle
from eitskin.reference.builder import ReferenceBuilder
from eitskin.reference.judged import reference_checks
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.parts import Electrodes, Scene, Touch
from eitskin_sim.scene.shapes import Disc

HELLO = SimpleNamespace(serial_number="DRAWN", configuration_digest=1, configuration_name="paper", volts_per_count=1e-9)

RNG = np.random.default_rng(12)


def solved(**parts):
    return solve_scene(Scene(element_size_mm=4.5, current_A=1e-3, **parts)).voltages


def captured(voltages, kind, older=None):
    builder = ReferenceBuilder(60)
    for _ in range(60):
        builder.add(add_noise(voltages, voltages, kind, 50.0, RNG))
    return builder.finish(HELLO, reference_checks(load_bundle(), older))


def own_electrodes():
    """Return electrodes of a real sheet: placed to 0.5 mm, with contacts of their own."""
    places = np.array(Electrodes().arc_length_mm) + RNG.normal(0.0, 0.5, 16)
    return Electrodes("patch", float(RNG.uniform(3.5, 4.5)), float(10 ** RNG.uniform(-5, -3)), tuple(places.tolist()))


def touch():
    x, y = RNG.uniform((20.0, 20.0), (130.0, 80.0))
    return Touch((Disc(float(x), float(y), float(RNG.uniform(5.0, 10.0))),))


@pytest.mark.parametrize("kind", ["N2", "N3"])
def test_an_honest_sheet_passes_without_a_word_and_a_touch_is_refused_against_it(kind):
    for bend in draw("A", 1, 77):
        electrodes = own_electrodes()
        first = captured(solved(electrodes=electrodes), kind)
        again = captured(solved(electrodes=electrodes), kind, first)
        assert first.judgement.remarks == again.judgement.remarks == ()
        for shape in ({}, {"bend": bend}):
            with pytest.raises(BadReference, match="touched"):
                captured(solved(electrodes=electrodes, touches=(touch(),), **shape), kind, first)
