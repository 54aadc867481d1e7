"""The law and the shared part of noise, on noise that is drawn by a known law."""

import numpy as np
import pytest

from eitskin_proto.sensor.noise_law import noise_law, noise_of, own_sd

VOLTS = np.geomspace(0.02, 1.0, 104)


def drawn(slope, frames=400, common=0.0, seed=0):
    rng = np.random.default_rng(seed)
    noise = 1e-3 * VOLTS**slope * rng.standard_normal((frames, 104))
    return VOLTS * (1.0 + common * rng.standard_normal((frames, 1))) + noise


@pytest.mark.parametrize(("slope", "protocol"), [(1.0, "adjacent"), (0.0, "opposite"), (0.8, "adjacent")])
def test_the_slope_of_noise_is_found_and_names_the_drive(slope, protocol):
    found = noise_law(drawn(slope))
    assert found.slope == pytest.approx(slope, abs=0.05)
    assert found.protocol == protocol
    assert found.first_share < 0.15  # by chance 0.1
    assert f"{protocol} drive suits it" in found.lines()[1]


def test_common_noise_is_in_the_first_components_and_common_drift_is_found():
    assert noise_law(drawn(1.0, common=0.01)).first_share > 0.9
    drifting = drawn(1.0) * np.where(np.arange(400) < 200, 1.0, 1.02)[:, None]
    assert noise_law(drifting).drift_percent == pytest.approx(2.0, abs=0.05)
    assert noise_law(drifting).slope == pytest.approx(1.0, abs=0.05), "from one frame to the next there is no drift"


@pytest.mark.parametrize("frames", [10, 100, 1000])
def test_independent_rows_share_nothing(frames):
    for seed in range(10):
        sd, shared = noise_of(np.random.default_rng(seed).standard_normal((frames, 104)))
        assert shared.shape == (104, 0)
        assert np.array_equal(own_sd(sd, shared), sd)


def test_a_shared_component_has_its_true_size_although_frames_are_as_few_as_rows():
    rng = np.random.default_rng(1)
    direction = rng.standard_normal(104)
    direction /= np.linalg.norm(direction)
    sizes = []
    for _ in range(20):
        frames = rng.standard_normal((100, 104)) + 5.0 * rng.standard_normal((100, 1)) * direction
        _, shared = noise_of(frames)
        assert shared.shape == (104, 1)
        sizes.append(np.sum(shared**2))
    assert np.mean(sizes) == pytest.approx(25.0, rel=0.2)


def test_too_few_frames_and_a_front_end_that_repeats_itself_are_refused():
    with pytest.raises(ValueError, match="expected at least 4 frames"):
        noise_law(drawn(1.0)[:3])
    with pytest.raises(ValueError, match="0 rows vary"):
        noise_law(np.tile(VOLTS, (10, 1)))
