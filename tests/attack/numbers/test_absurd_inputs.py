"""References, clouds and predictions that no sheet gives: refused in one line, or every published map is in range."""

import warnings
from contextlib import suppress

import numpy as np
import pytest

from eitskin.errors import PortLost, SkinError
from eitskin.reference.captured import Reference
from eitskin.skin import Skin
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.parts import Bend
from eitskin_sim.surface.measured_cloud import measured_cloud

from ..line.line import FLAT, HELLO, Line
from ..stream import TINY

FLAT_V = FLAT * HELLO.volts_per_count
DENORMAL = 5e-324
CLOUD = np.asarray(measured_cloud(Bend(angle_deg=60.0), np.random.default_rng(0)), dtype=np.float64)


def published(reference_V, use=lambda skin: None):
    """Return the maps of five honest frames, none where the input is refused in one line."""
    line = Line(lambda line, _: line.frame(), clocked=False, scans_left=5)
    maps, refusal = [], ""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a warning of numpy in the loop is a value that no check caught
        try:
            reference = Reference(
                reference_V, np.zeros_like(FLAT_V), 2, HELLO.serial_number, HELLO.configuration_digest, "attack", ""
            )
            with Skin(line, bundle=TINY, reference=reference) as skin:
                use(skin)
                with suppress(PortLost):
                    maps.extend(np.array(frame.map) for frame in skin.frames())
        except (SkinError, ValueError) as error:
            refusal = str(error)
    assert "\n" not in refusal
    return maps


def assert_in_range(maps):
    assert all(np.isfinite(one).all() and one.min() >= 0.0 and one.max() <= 1.0 for one in maps)


def test_honest_frames_are_published():
    assert len(published(FLAT_V, lambda skin: skin.set_cloud(CLOUD))) == 5


@pytest.mark.parametrize("value", [DENORMAL, 1e-310, 1e-200, 1e-20, 1e200, 1e308, np.inf, -np.inf, np.nan, 0.0])
def test_a_reference_of_absurd_voltages_gives_no_absurd_map(value):
    one_row = FLAT_V.copy()
    one_row[40] = value
    for reference_V in (one_row, np.full_like(FLAT_V, value), FLAT_V / np.abs(FLAT_V).max() * value):
        assert_in_range(published(reference_V))


def absurd_clouds():
    for value in (np.nan, np.inf, -np.inf, 1e308, 1e30, 999.0, DENORMAL):
        one_point = CLOUD.copy()
        one_point[1, 7, 7] = value
        yield one_point
        yield np.full_like(CLOUD, value)
    yield PAPER.grid.flat_cloud_mm() * np.array([1.0, 0.0, 0.0])[:, None, None]  # a line
    yield CLOUD * 1e-310
    yield np.random.default_rng(0).uniform(-999.0, 999.0, CLOUD.shape)
    yield CLOUD[:, :5]
    yield "cloud"
    yield CLOUD * 1j


def test_an_absurd_cloud_gives_no_absurd_map():
    for cloud in absurd_clouds():
        assert_in_range(published(FLAT_V, lambda skin, cloud=cloud: skin.set_cloud(cloud)))


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, DENORMAL, 1e-300, 1e30, 1e308, -1.0])
def test_an_absurd_prediction_gives_no_absurd_map(value):
    volts = np.full_like(FLAT_V, value)
    for bent, flat in ((volts, None), (FLAT_V, volts)):
        assert_in_range(
            published(FLAT_V, lambda skin, p=bent, f=flat: skin.set_cloud(CLOUD, predicted=p, predicted_flat=f))
        )
