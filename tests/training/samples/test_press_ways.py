"""Which way recorded presses go is told by a model of the sheet; presses that contradict each other in it are named."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.skin.parts import Touches
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.calibration.recording import LaterReading, Recording
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import gather
from eitskin_training.samples.presses import check_ways, piece, ways

pytestmark = pytest.mark.slow

PLACES = [(40.0, 30.0), (75.0, 50.0), (140.0, 8.0), (110.0, 75.0)]
BOTH = replace(PAPER, name="ours", touches=Touches(kind="both"))
LOWERING = replace(PAPER, name="ours", touches=Touches(kind="lower"))


@pytest.fixture(scope="module")
def recorded() -> Any:
    """Return what makes a recording of presses of given contrasts, under a drift of 2 %."""
    flat = inverted_sheet(Bend())

    def of(contrasts: Any, said: Any = PLACES) -> Recording:
        true = [LaterReading(flat.untouched_V, 1, None, np.array(place), (16.0,)) for place in PLACES]
        table = gather([piece(one, contrast) for one, contrast in zip(true, contrasts, strict=True)])
        volts = 0.98 * set_voltages([flat], table)[0]
        later = [replace(a, voltages_V=b, xy_mm=np.array(c)) for a, b, c in zip(true, volts, said, strict=True)]
        return Recording(flat.untouched_V, 1, (), tuple(later))

    return of


def test_each_goes_its_way_unless_it_was_elsewhere(recorded: Any) -> None:
    assert ways(recorded([0.3, 0.9, 0.5, 0.6]), PAPER) == ["lower"] * 4
    assert ways(recorded([50.0, 1.2, 3.0, 5.0]), PAPER) == ["raise"] * 4
    elsewhere = [(110.0, 30.0), *PLACES[1:]]
    assert ways(recorded([0.3, 2.0, 0.5, 0.6], elsewhere), PAPER) == [None, "raise", "lower", "lower"]


def test_presses_of_opposite_ways_are_named_unless_the_skin_and_the_bundle_know_both(recorded: Any) -> None:
    mixed = recorded([0.5, 2.0, 0.5, 0.5])
    said = r"press 1 at \(75, 50\) mm raises conductance and press 0 at \(40, 30\) mm lowers it; leave out"
    for skin in (LOWERING, PAPER):
        with pytest.raises(SkinError, match=said):
            check_ways(mixed, skin, "both", "bundle x")
    check_ways(mixed, BOTH, "both", "bundle x")
    with pytest.raises(MismatchError, match=r"press 1 .*: touches: found raise, expected lower, as bundle x knows"):
        check_ways(mixed, BOTH, "lower", "bundle x")
