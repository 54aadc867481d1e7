"""A sheet that was seen untouched is known better than by its scan, and as by its scan again where it has changed."""

from itertools import count

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.shapes.sheet import TouchedSheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.verification.free.found import map_of
from eitskin_sim.verification.free.search import FreeVerifier
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet import model

Array = npt.NDArray[np.float64]

UNEVEN = Bend(angle_deg=100.0, axis_deg=20.0, skew=0.3, stretch_along=1.1, stretch_across=1.03, nonuniformity=0.13)
"""Its stretch is not as even as its scan seems to show."""

GAUGE = 1.2
"""More than a sheet is likely to have."""

UNLIKELY_GAUGE = 2.0
"""No touches, made or not, explain a frame of such a sheet: of 1.2 they explain some, by its noise and by rounding."""

PIECES = np.array([[0, 40.0, 35.0, 10.0, 10.0, 0.0, 50.0, 0.0], [0, 100.0, 60.0, 10.0, 10.0, 0.0, 50.0, 0.0]])
NOTHING = np.zeros((0, 8))

NEAR_MM = 1.0
"""A tenth of a touch: three times what noise of 50 dB moves one by."""


@pytest.fixture(scope="module")
def sheet() -> TouchedSheet:
    return made(GAUGE)


def made(gauge: float) -> TouchedSheet:
    return model._touched(bend_metric(UNEVEN, nominal_sheet(PAPER)), PAPER, gauge=gauge)


def read(sheet: TouchedSheet, pieces: Array, seed: int, noise: float = 3e-3) -> Array:
    return sheet.solve(pieces).voltages_V * (1.0 + noise * np.random.default_rng(seed).standard_normal(104))


def at_rest(sheet: TouchedSheet, frames: int = 50) -> Array:
    return np.mean([read(sheet, NOTHING, seed) for seed in range(frames)], axis=0)


def shares_of(pieces: Array) -> Array:
    return np.array([map_of(one[None]) for one in pieces])


def verifier() -> FreeVerifier:
    """Return one of the scanned sheet, whose time is counted in looks at the clock."""
    looks = count()
    own = FreeVerifier(model.flat_model_V(PAPER), Noise("N2", 50.0), clock=lambda: float(next(looks)))
    own.deform(measured_cloud(UNEVEN, None, skin=PAPER))
    return own


def test_what_was_seen_at_rest_explains_what_is_touched_there(sheet: TouchedSheet) -> None:
    own = verifier()
    assert own.rest(at_rest(sheet), 50)
    rested = own.deformation.model
    known = [own.verify(read(sheet, PIECES, seed), shares_of(PIECES), budget_s=400.0) for seed in (1, 2)]
    for found in known:
        assert not found.flagged
        assert "loosen" not in found.trail
        assert found.pieces[:, 1:3] == pytest.approx(PIECES[:, 1:3], abs=NEAR_MM)
    assert own.deformation.model is rested, "frames are explained by what is known: no model is made for them"


def test_a_frame_that_nothing_explains_is_asked_roughly_how_the_sheet_conducts() -> None:
    """Without a look at it untouched: a gauge factor that is unlikely is refused, until nothing else is left."""
    own, odd = verifier(), made(UNLIKELY_GAUGE)
    first = own.verify(read(odd, PIECES, 1), shares_of(PIECES), budget_s=1600.0)
    assert "loosen" in first.trail
    assert own.deformation.is_rough
    second = own.verify(read(odd, PIECES, 2), shares_of(PIECES), budget_s=1600.0)
    assert second.trail == ()
    for found in (first, second):
        assert not found.flagged
        assert found.pieces[:, 1:3] == pytest.approx(PIECES[:, 1:3], abs=NEAR_MM)


def test_a_sheet_that_has_changed_since_is_verified_by_its_scan(sheet: TouchedSheet) -> None:
    own = verifier()
    assert own.rest(at_rest(sheet), 50)
    flat = np.random.default_rng(7).standard_normal(4) @ np.array([np.sin(k * np.arange(104.0)) for k in range(1, 5)])
    slipped = read(sheet, PIECES, 1) * (1.0 + 0.03 * flat)
    before = own.deformation.model
    assert own.verify(slipped, shares_of(PIECES), budget_s=400.0).flagged
    assert not own.deformation.may_be_looser, "the scan's own model and a looser one were tried"
    assert own.deformation.model is before, "nonsense spoils nothing"


def test_what_is_not_the_scanned_sheet_changes_nothing(sheet: TouchedSheet) -> None:
    own = verifier()
    before = own.deformation.model
    assert not own.rest(at_rest(sheet) * np.random.default_rng(1).uniform(0.3, 2.0, 104), 50)
    assert own.deformation.model is before
    assert own.deformation.may_be_made_anew
    odd = at_rest(sheet)
    odd[3] = np.nan
    with pytest.raises(ValueError, match="voltages: 1 of 104 are not finite"):
        own.rest(odd)
    with pytest.raises(ValueError, match="no deformation"):
        FreeVerifier(model.flat_model_V(PAPER), Noise()).rest(at_rest(sheet))
    with pytest.raises(ValueError, match="0 frames"):
        own.rest(at_rest(sheet), 0)


def test_another_deformation_is_known_by_its_scan_alone(sheet: TouchedSheet) -> None:
    own = verifier()
    assert own.rest(at_rest(sheet), 50)
    assert own.deformation.model.rest is not None
    own.deform(flat_cloud())
    assert own.deformation.model.rest is None
    assert own.deformation.may_be_made_anew


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_what_no_sheet_has_is_not_believed(sheet: TouchedSheet) -> None:
    own = verifier()
    before = own.deformation.model
    nonsense = np.zeros(before.unseen.columns.shape[1])
    nonsense[before.unseen.n_waves + before.unseen.names.index("gauge")] = -1e6
    assert before.about(nonsense) is None
    own.deformation.make_anew(nonsense)
    assert own.deformation.model is before
    assert not own.verify(read(sheet, PIECES[:1], 1), shares_of(PIECES[:1]), budget_s=400.0).flagged
