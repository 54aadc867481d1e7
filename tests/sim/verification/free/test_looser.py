"""A sheet whose material lies farther from where its scan shows it than usual is verified on a looser model."""

from itertools import count
from typing import Final

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import flat_metric_of, nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.shapes.sheet import TouchedSheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.verification.free.found import map_of
from eitskin_sim.verification.free.search import FreeVerifier
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet import model
from eitskin_sim.verification.sheet.waves import waves_of

Array = npt.NDArray[np.float64]

FARTHER: Final = 0.8
"""Of every wave's spread: a flat sheet whose scan shows nothing of it has a tenth."""

BUMPS = Bend(
    angle_deg=132.7, axis_deg=2.8, skew=0.593, twist_deg=-2.0, stretch_along=1.017, stretch_across=1.108,
    nonuniformity=-0.133, bumps_mm=((131.4, 45.5, 6.0, 20.1), (72.2, 36.4, 6.0, 15.5)),
)  # fmt: skip
"""Uneven stretch, and bumps that carry material with them: what deformations of the skin's family do not do."""

PAIR = np.array([[0, 28.0, 35.0, 10.0, 10.0, 0.0, 60.0, 0.0], [0, 48.0, 35.0, 10.0, 10.0, 0.0, 60.0, 0.0]])


@pytest.fixture(scope="module")
def loose() -> TouchedSheet:
    """Return a flat sheet whose material lies far from where the scan shows it, in all ways at once."""
    waves = waves_of(PAPER)
    off = FARTHER * waves.sd * np.random.default_rng(5).choice([-1.0, 1.0], len(waves.sd))
    return model._touched(waves.moved(flat_metric_of(PAPER), off), PAPER)


def read(sheet: TouchedSheet, pieces: Array, seed: int) -> Array:
    return sheet.solve(pieces).voltages_V * (1.0 + 3e-3 * np.random.default_rng(seed).standard_normal(104))


def shares_of(pieces: Array) -> Array:
    return np.array([map_of(one[None]) for one in pieces])


def verifier(cloud_mm: npt.ArrayLike) -> FreeVerifier:
    """Return one whose time is counted in looks at the clock."""
    looks = count()
    own = FreeVerifier(model.flat_model_V(PAPER), Noise("N2", 50.0), clock=lambda: float(next(looks)))
    own.deform(cloud_mm)
    return own


def material_of(own: FreeVerifier) -> float:
    return own.deformation.model.spreads.material


def test_what_nothing_explains_is_tried_on_a_looser_sheet_which_serves_the_frames_after_it(loose: TouchedSheet) -> None:
    own = verifier(flat_cloud())
    found = own.verify(read(loose, PAIR, 1), shares_of(PAIR), budget_s=600.0)
    assert "loosen" in found.trail
    assert not found.flagged
    assert found.pieces[:, 1:3] == pytest.approx(PAIR[:, 1:3], abs=6.0)  # moved along with material that nobody sees
    assert material_of(own) == model.LOOSER
    after = own.verify(read(loose, PAIR[:1], 2), shares_of(PAIR[:1]), budget_s=600.0)
    assert not after.flagged
    assert "loosen" not in after.trail
    own.deform(flat_cloud())
    assert material_of(own) == 1.0


def test_bumps_that_a_scan_shows_ask_for_no_looser_sheet() -> None:
    cloud = measured_cloud(BUMPS, None, skin=PAPER)
    bumpy = model._touched(bend_metric(BUMPS, nominal_sheet(PAPER)), PAPER)
    own = verifier(cloud)
    found = own.verify(read(bumpy, PAIR, 1), shares_of(PAIR), budget_s=600.0)
    assert "loosen" not in found.trail
    assert not found.flagged
    assert found.pieces[:, 1:3] == pytest.approx(PAIR[:, 1:3], abs=6.0)  # moved along with material that nobody sees


def test_nonsense_is_no_loose_sheet_and_a_usual_frame_asks_for_none() -> None:
    flat = model.model_of_cloud(flat_cloud()).touched
    own = verifier(flat_cloud())
    nonsense = read(flat, PAIR[:1], 1) * (1.0 + 0.05 * np.random.default_rng(3).standard_normal(104))
    assert own.verify(nonsense, shares_of(PAIR[:1]), budget_s=400.0).flagged
    assert not own.deformation.may_be_looser, "it was tried"
    assert material_of(own) == 1.0
    other = verifier(flat_cloud())
    assert not other.verify(read(flat, PAIR, 2), shares_of(PAIR), budget_s=600.0).flagged
    assert other.deformation.may_be_looser
