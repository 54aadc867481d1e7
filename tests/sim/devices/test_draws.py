"""Draws of devices: as a skin says, the same from the same seed, and nothing where nothing is uncertain."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.parts import Outline
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import named
from eitskin_sim.devices.device import IDEAL
from eitskin_sim.devices.draws import (
    MAX_DRIFT,
    MAX_ELECTRODE_OFFSET_MM,
    draw_device,
    draw_drift,
    draw_moment,
)
from eitskin_sim.devices.readings import readings, sheet_differences
from eitskin_sim.scene.parts import Bend, Electrodes

LAB = named("lab")


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_seed_names_a_device() -> None:
    one, same, other = (draw_device(LAB, rng(seed)) for seed in (3, 3, 4))
    assert one == same
    assert one != other
    assert draw_moment(LAB, rng(3)) == draw_moment(LAB, rng(3))


def test_a_skin_without_doubts_has_the_ideal_device_alone() -> None:
    drawn, moment = draw_device(PAPER, rng(0)), draw_moment(PAPER, rng(0))
    bend = Bend(stretch_along=1.1, twist_deg=5.0)
    assert drawn.bent(bend) == bend
    assert drawn.reference_bend == Bend()
    found = sheet_differences(drawn.device.since(moment.late), bend)
    assert found == pytest.approx(sheet_differences(IDEAL, bend), rel=1e-12)
    assert readings(drawn.device, found) == pytest.approx(readings(IDEAL, found), rel=1e-9)
    assert np.all(draw_drift(PAPER, 50, rng(0)) == 1.0)
    assert (moment.scan_factor, moment.scan_amplitude) == (1.0, 1.0)
    assert moment.scan_noise_mm == pytest.approx(0.1)


def test_electrodes_are_off_as_the_skin_says_and_never_beyond_what_is_seen() -> None:
    nominal = Electrodes()
    drawn = [draw_device(LAB, rng(seed)).device.electrodes for seed in range(200)]
    off = np.array([one.arc_length_mm for one in drawn]) - np.array(nominal.arc_length_mm)
    assert off.std() == pytest.approx(0.7, rel=0.05)
    assert np.abs(off).max() <= MAX_ELECTRODE_OFFSET_MM
    impedance = np.log([one.impedances_ohm_m2() for one in drawn])
    assert impedance.std() == pytest.approx(1.2, rel=0.05)


def test_drift_walks_from_little_to_the_skins_spread_with_a_few_far_beyond() -> None:
    drift = np.abs(np.log(draw_drift(LAB, 50_000, rng(1))))
    assert 0.001 < np.median(drift) < 0.006
    assert 0.01 < np.quantile(drift, 0.9) < 0.03
    assert 0.005 < np.mean(drift > 0.1) < 0.02
    assert drift.max() <= MAX_DRIFT + 1e-12


def test_skins_that_the_generators_have_no_mesh_for_are_refused() -> None:
    disc = replace(PAPER, outline=Outline("disc", (160.0, 160.0)))
    with pytest.raises(ValueError, match="kind is 'disc', expected 'rectangle': the forward model solves no other"):
        draw_device(disc, rng(0))


def test_contacts_on_the_edge_are_drawn_as_patches_are_and_may_pass_the_corner() -> None:
    patches = draw_device(LAB, rng(0)).device.electrodes
    edge = replace(LAB, electrodes=replace(LAB.electrodes, contact="edge"))
    assert draw_device(edge, rng(0)).device.electrodes == replace(patches, contact="edge")
    arc = tuple((np.array(patches.arc_length_mm) - patches.arc_length_mm[0]).tolist())
    moved = replace(edge.electrodes, arc_length_mm=replace(LAB.electrodes.arc_length_mm, value=arc))
    first = [draw_device(replace(edge, electrodes=moved), rng(s)).device.electrodes.arc_length_mm[0] for s in range(9)]
    assert min(first) >= 0.0
    assert max(first) > 490.0
