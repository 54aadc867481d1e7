import numpy as np
import pytest

from eitskin_proto.skin.cloud import align_cloud, check_cloud, flat_cloud, network_input


def bent(radius_mm=70.0):
    flat = flat_cloud()
    angle = (flat[0] - 75.0) / radius_mm
    return np.stack([radius_mm * np.sin(angle), flat[1] + 0.1 * flat[0], radius_mm * np.cos(angle)])


def rotation(rng):
    matrix, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return matrix * np.sign(np.linalg.det(matrix))


def test_the_flat_cloud_stays_where_it_is():
    # 1e-11 mm: a few hundred roundings of numbers of size 150; a pose wrong by 1e-9 mm would fail.
    assert np.abs(align_cloud(flat_cloud()) - flat_cloud()).max() < 1e-11


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("make", [flat_cloud, bent, lambda: bent(-40.0)])
def test_the_pose_of_the_scanner_does_not_matter(seed, make):
    rng = np.random.default_rng(seed)
    moved = np.einsum("ij,jrc->irc", rotation(rng), make()) + rng.uniform(-300, 300, (3, 1, 1))
    aligned = align_cloud(make())
    assert np.abs(align_cloud(moved) - aligned).max() < 1e-10  # rounding of coordinates up to 1000 mm: 1e-13 each
    assert np.abs(network_input(moved) - network_input(make())).max() < 1e-6  # float32 of numbers of order one


def test_alignment_is_the_best_of_all_nearby_poses():
    aligned, flat = align_cloud(bent()), flat_cloud()
    best = np.sum((aligned - flat) ** 2)
    centre = aligned.mean(axis=(1, 2), keepdims=True)
    for axis in range(3):
        for turn in (-1e-3, 1e-3):
            i, j = [k for k in range(3) if k != axis]
            small = np.eye(3)
            small[i, i] = small[j, j] = np.cos(turn)
            small[i, j], small[j, i] = -np.sin(turn), np.sin(turn)
            turned = np.einsum("ij,jrc->irc", small, aligned - centre) + centre
            assert np.sum((turned - flat) ** 2) > best


def broken(value, where=(2, 3, 4)):
    cloud = flat_cloud()
    cloud[where] = value
    return cloud


@pytest.mark.parametrize(
    ("cloud", "text"),
    [
        (broken(np.nan), r"cloud\[2, 3, 4\] is nan, expected a finite number of mm; 1 of 4050"),
        (np.full((3, 30, 45), 0x7F800001, dtype="<u4").view("<f4"), r"cloud\[0, 0, 0\] is nan"),  # one that signals
        (broken(np.inf), r"cloud\[2, 3, 4\] is inf"),
        (broken(-100_001.0), r"cloud\[2, 3, 4\] is -100001 mm, expected at most 100000 mm from the origin"),
        (np.zeros((3, 45, 30)), r"\(3, 30, 45\).*found \(3, 45, 30\)"),
        (np.zeros((30, 45, 3)), r"found \(30, 45, 3\)"),
        ("cloud", r"must be numbers.*found str"),
        ([[1, 2], [3]], r"must be numbers.*found list"),
    ],
)
def test_a_bad_cloud_is_refused_with_value_and_bound(cloud, text):
    for function in (check_cloud, align_cloud, network_input):
        with pytest.raises(ValueError, match=text):
            function(cloud)


@pytest.mark.parametrize("scale", [1e-310, 1e-3, 20.0])
def test_cloud_that_is_far_too_small_or_too_large_is_refused_with_its_bounds(scale):
    cloud = flat_cloud()
    centre = cloud.mean(axis=(1, 2), keepdims=True)
    with pytest.raises(ValueError, match=r"one line or in one point|expected 5 to 500 mm"):
        align_cloud(scale * (cloud - centre))
