"""The gate of random devices: what it takes for untouched, that no drift trips it, and what it finds."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eitskin_proto.sensor.row_gaussian import log_of_ratio
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import named
from eitskin_sim.devices.draws import draw_device, draw_moment
from eitskin_sim.devices.readings import readings
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.parts import Bend, Scene
from eitskin_training.gate import filters, fit, moments, rates, untouched
from eitskin_training.gate.touches import Probe
from eitskin_training.gate.untouched import Bends
from eitskin_training.samples.batches import TrainingData

pytestmark = [pytest.mark.slow, pytest.mark.heavy]

LAB = named("lab")
FLAT = replace(LAB, may_be_off=replace(LAB.may_be_off, reference_stretch=Quantity(0.0), late_rms=(0.0, 0.0)))
"""Its references are taken of the sheet as it lies, and its layer stays as it was."""


@pytest.fixture(scope="module")
def data(toy_data: Any) -> TrainingData:
    made: TrainingData = toy_data("area", bends=12, samples=2400)
    return replace(made, skin=LAB, touch_kind="lower", drift=np.ones(len(made.voltages), dtype=np.float32))


@pytest.fixture(scope="module")
def bends() -> Bends:
    """Return a toy's bends: what a common factor leaves of them is one pattern, of any strength."""
    rng = np.random.default_rng(1)
    logs = 0.05 * rng.standard_normal((120, 1)) * rng.standard_normal(104)
    return Bends(logs[:40], logs[40:80], logs[80:], devices=LAB)


@pytest.fixture(scope="module")
def fitted(data: TrainingData, bends: Bends) -> fit.Gate:
    return fit.fit(data, bends)


def test_devices_of_a_skin_without_doubts_move_as_the_nominal_bends_do() -> None:
    members = draw("A", 2, 5)
    np.testing.assert_allclose(moments.moments(members, PAPER, 3), untouched.untouched_logs(members, PAPER), atol=1e-9)
    drawn = moments.drawn_moments(members[:1], PAPER, 3, 1, each=2)
    np.testing.assert_allclose(drawn, untouched.untouched_logs(members[:1] * 2, PAPER), atol=1e-6)


def test_a_device_is_compared_with_its_own_reference() -> None:
    """A device of uneven layer and other electrodes, flat and just referenced, has changed by nothing."""
    np.testing.assert_allclose(moments.moments([Bend()], FLAT, 4), 0.0, atol=1e-12)
    assert 1e-4 < np.abs(moments.moments([Bend()], LAB, 4)).mean() < 0.2


def test_a_drawn_device_is_nearly_one_that_is_solved() -> None:
    """What sets it apart from the nominal device is met to a twentieth, and to less than noise of 52 dB in a row."""
    skin, bend = named("hydrogel"), draw("A", 2, 5)[1]
    rng = np.random.default_rng(3)
    sheets, flat = moments.Sheets.solved([bend], skin, rng), moments.References.solved(skin)
    drawn, late = draw_device(skin, rng), draw_moment(skin, rng).late
    own = replace(drawn.device.sheet, gauge_factor=float(sheets.gauges[0]))
    drawn = replace(
        drawn, device=replace(drawn.device, sheet=own), scale=(float(sheets.scales[0, 0]), float(sheets.scales[0, 1]))
    )
    now, before = moments.about(sheets, flat, drawn, np.array([0]), [late], np.zeros(1))
    found = log_of_ratio(readings(drawn.device, now[0]), readings(drawn.device, before[0]))

    def solved(device: Any, at: Bend) -> Any:
        scene = Scene(device.sheet, device.electrodes, bend=at, element_size_mm=moments.COARSE_MM)
        return readings(device, factorise_scene(scene).differences())

    wanted = log_of_ratio(
        solved(drawn.device.since(late), drawn.bent(bend)), solved(drawn.device, drawn.reference_bend)
    )
    usual = untouched.untouched_logs([bend], skin)[0]
    off, own_share = ((logs - logs.mean()) for logs in (found - wanted, wanted - usual))
    assert np.linalg.norm(off) < np.linalg.norm(own_share) / 20
    assert np.median(np.abs(off)) < 0.3 * 10 ** (-52 / 20)


@pytest.mark.parametrize("prefix", ["", "idle_"])
def test_no_common_factor_moves_a_gate_of_devices_that_drift(fitted: fit.Gate, prefix: str) -> None:
    rng = np.random.default_rng(0)
    rows = len(fitted.arrays[f"{prefix}mean"]) // 2
    logs = 0.02 * rng.standard_normal((20, rows))
    usual = fit.logits(fitted.arrays, np.expm1(logs), prefix)
    for drift in (-0.3, 0.01, 0.3):
        found = fit.logits(fitted.arrays, np.expm1(logs + drift), prefix)
        np.testing.assert_allclose(found, usual, atol=1e-3 * np.abs(usual).max())


def test_filters_find_what_stands_out_of_a_moment_of_any_scale() -> None:
    """The network's output is above 0 where the largest filter is above the limit, and twice the moment is no touch."""
    rng = np.random.default_rng(0)
    whitening = rng.standard_normal((20, 12))
    own = filters.bank(rng.standard_normal((300, 12)), rng)
    assert own.shape == (filters.FILTERS, 12)
    np.testing.assert_allclose(np.linalg.norm(own, axis=1), 1.0)
    logs = rng.standard_normal((500, 20)) * rng.choice((0.1, 1.0, 10.0), (500, 1))
    ratios = filters.ratios(logs @ whitening, own)
    limit = float(np.median(ratios))
    first, second, bias = filters.layers(whitening, own, limit)
    out = np.maximum(np.maximum(logs @ first, 0.0) @ second + bias, 0.0).sum(axis=1)
    np.testing.assert_array_equal(out > 1e-9, ratios > limit + 1e-9)
    assert filters.ratios(np.full((1, 12), 1e6), own) == pytest.approx(filters.ratios(np.full((1, 12), 2e6), own), 1e-5)


def test_frames_of_a_press_are_counted_once_it_is_found_in_any_of_them(data: TrainingData, bends: Bends) -> None:
    logs = np.zeros((60, 104))
    probed = replace(bends, probes=(Probe("none", "flat", logs, logs),))
    coin = np.random.default_rng(3)

    def judge(dv: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
        return coin.random(len(dv))

    found = rates.found_presses(judge, 0.8, probed, data, np.random.default_rng(0), draws=15)["none"]
    for family in ("flat", "devices"):
        assert found[family]["1"] == pytest.approx(0.2, abs=0.06)
        assert found[family]["5"] == pytest.approx(1.0 - 0.8**5, abs=0.07)


def test_the_card_states_what_is_found(data: TrainingData, bends: Bends) -> None:
    logs = 0.1 * np.random.default_rng(4).standard_normal((5, 104))
    probed = replace(bends, probes=(Probe("press of 50 mm2", "flat", logs, 0.0 * logs),))
    facts = fit.fit(data, probed).facts()
    assert set(facts["found_presses"]["press of 50 mm2"]) == {"flat", "devices"}
    assert "found_presses" not in facts["idle"]
