"""A network for faint touches takes the place of the bundle's own where that shows nothing large, and smoothly so."""

import zipfile
from types import SimpleNamespace

import numpy as np
import pytest
from tests.runtime.model.test_small_network import bent, changed

from eitskin.errors import BundleError
from eitskin.model import gentle
from eitskin.model.buffers import Buffers
from eitskin.model.bundle import graphs_of, load_bundle
from eitskin.model.engine import engines, solvers
from eitskin.model.gentle import EDGES_PX, FIRM, RAMP, SURE, VERY_WIDE, WINDOW_MM, GentleEngine, edges_px
from eitskin.model.geometry import GeometryGraph
from eitskin_proto.skin.skin import PAPER

GRID = PAPER.grid
OWN = ("geometry.onnx", "head_int8.onnx")


def engine(own, gentle_map, **more):
    """An engine whose own network gives one map and whose gentle one another, the map, and what ran."""
    whole, ran = np.zeros((1, GRID.n_pixels), dtype=np.float32), []

    def filled(name, values):
        def infer():
            ran.append(name)
            whole[0] = values.ravel()

        return SimpleNamespace(name=name, infer=infer)

    return GentleEngine(filled("own", own), filled("gentle", gentle_map), whole, PAPER, **more), whole[0], ran


def touched(pixels, row=12, column=20, value=1.0):
    """A map with so many pixels touched, in rows of three."""
    found = np.zeros(GRID.shape, dtype=np.float32)
    for number in range(pixels):
        found[row + number // 3, column + number % 3] = value
    return found


@pytest.mark.parametrize(
    ("pixels", "expected"),
    [(0, ["own"]), (1, ["own", "gentle"]), (5, ["own", "gentle"]), (7, ["own", "gentle"]), (9, ["own"])],
)
def test_only_where_the_own_map_shows_faint_touches_alone_the_other_network_runs(pixels, expected):
    one, whole, ran = engine(touched(pixels), touched(12))
    one.infer()
    assert ran == expected
    assert one.name == "own"
    if expected == ["own"]:
        assert np.array_equal(whole, touched(pixels).ravel())


def test_between_the_bounds_either_map_has_its_share_without_a_jump():
    pixel = GRID.size_mm[0] * GRID.size_mm[1] / GRID.n_pixels
    other = touched(12, row=3)
    for shown in (*SURE, 0.5 * sum(SURE), SURE[0] + 0.01, SURE[1] - 0.01):
        own = touched(9, value=shown / (9 * pixel))
        one, whole, _ = engine(own, other)
        one.infer()
        share = min(max((shown - SURE[0]) / (SURE[1] - SURE[0]), 0.0), 1.0)
        expected = share * own + (1.0 - share) * other if share < 1.0 else own
        np.testing.assert_allclose(whole, expected.ravel(), atol=1e-3)


@pytest.mark.parametrize("skin_shape", [(30, 45), (1, 45), (7, 3)])
def test_what_is_shown_is_the_most_in_any_window(skin_shape):
    rng = np.random.default_rng(3)
    values = rng.random(skin_shape, dtype=np.float32)
    skin = SimpleNamespace(grid=SimpleNamespace(shape=skin_shape, size_mm=(150.0, 100.0)))
    one = GentleEngine(SimpleNamespace(name="own"), SimpleNamespace(), values.reshape(1, -1), skin)
    down, across = (
        min(max(1, round(WINDOW_MM * count / side)), count)
        for count, side in zip(skin_shape, (100.0, 150.0), strict=True)
    )
    windows = np.lib.stride_tricks.sliding_window_view(values, (down, across))
    expected = windows.sum(axis=(2, 3)).max() * 15000.0 / values.size
    assert one.shown_mm2() == pytest.approx(float(expected), rel=1e-5)


def blob(side_px, width_px, at=(15.0, 22.0)):
    """A map of a square touch whose edges are logistic."""
    found = 1.0
    for axis, (count, middle) in enumerate(zip(GRID.shape, at, strict=True)):
        inside = side_px / 2 - np.abs(np.arange(count) + 0.5 - middle)
        found = found * np.expand_dims(1.0 / (1.0 + np.exp(-inside / width_px)), 1 - axis)
    return found.astype(np.float32)


@pytest.mark.parametrize("width_px", [0.3, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_straight_edge_is_as_wide_as_it_is(width_px, axis):
    along = 1.0 / (1.0 + np.exp(-(np.arange(60) - 29.5) / width_px))
    edge = np.broadcast_to(np.expand_dims(along, 1 - axis), (60, 60)).astype(np.float32)
    assert edges_px(edge) == pytest.approx(width_px, rel=0.06), "0.3 is less than pixels resolve"


def test_a_firm_touch_with_sharp_edges_asks_nobody():
    sharp = blob(4.0, 0.1)
    assert edges_px(sharp) < EDGES_PX[0]
    one, whole, ran = engine(sharp, blob(6.0, 0.1))
    one.infer()
    assert ran == ["own"]
    assert np.array_equal(whole, sharp.ravel())


def test_a_firm_touch_with_wide_edges_is_drawn_by_the_network_that_shows_it_much_larger():
    own, other = blob(4.0, 0.5), blob(6.0, 0.3)
    assert edges_px(own) > EDGES_PX[1]
    one, whole, ran = engine(own, other)
    one.infer()
    assert one.shown_mm2() > SURE[1], "it is firm"
    assert ran == ["own", "gentle"]
    np.testing.assert_allclose(whole, other.ravel(), atol=1e-6)


def test_it_stays_as_it_is_where_the_other_network_shows_no_more():
    own = blob(4.0, 0.5)
    one, whole, ran = engine(own, blob(4.0, 0.4))
    one.infer()
    assert ran == ["own", "gentle"]
    np.testing.assert_allclose(whole, own.ravel(), atol=1e-6)


def test_a_map_that_is_not_finite_is_not_hidden_behind_the_other_network_s():
    own = np.where(blob(4.0, 0.5) > 0.9, np.nan, blob(4.0, 0.5)).astype(np.float32)
    one, whole, ran = engine(own, blob(6.0, 0.3))
    one.infer()
    assert ran == ["own"]
    assert np.isnan(whole).any()


def test_a_head_that_is_there_for_its_speed_does_not_ask():
    own = blob(4.0, 0.5)
    one, whole, ran = engine(own, blob(6.0, 0.3), asks=False)
    one.infer()
    assert ran == ["own"]
    assert np.array_equal(whole, own.ravel())


@pytest.mark.parametrize(("touches", "width_px"), [(1, 0.4), (2, 0.4), (1, 0.6), (1, 0.9)])
def test_how_much_larger_decides_by_degrees_and_sooner_the_wider_the_edges(touches, width_px):
    own = np.maximum.reduce([blob(4.0, width_px, at) for at in ((15.0, 12.0), (15.0, 34.0))[:touches]])
    ratios, shares = np.linspace(1.0, 3.0, 201), []
    for more in ratios:
        other = (float(more) * own.sum() / own.size) * np.ones_like(own)
        one, whole, _ = engine(own, other)
        one.infer()
        shares.append(float((whole[0] - own[0, 0]) / (other[0, 0] - own[0, 0])))
    one.own.infer()
    (narrow, broad), least = VERY_WIDE
    likely = np.interp(one.shown_mm2(), *FIRM)
    likely += (least - likely) * np.clip((edges_px(own) - narrow) / (broad - narrow), 0.0, 1.0)
    np.testing.assert_allclose(shares, np.clip((ratios - likely) / RAMP + 0.5, 0.0, 1.0), atol=1e-3)


@pytest.fixture
def with_gentle(tiny_path, tmp_path):
    """The tiny bundle with its int8 head and its geometry as a network for gentle touches."""
    out, graphs = tmp_path / "gentle.eitskin", dict(zip(graphs_of("gentle"), OWN, strict=True))

    def more(manifest):
        manifest["gentle"] = {"bias": manifest["head"]["bias"]}
        manifest["files"] |= {name: manifest["files"][own] for name, own in graphs.items()}

    changed(tiny_path, out, more)
    with zipfile.ZipFile(tiny_path) as archive, zipfile.ZipFile(out, "a") as longer:
        for name, own in graphs.items():
            longer.writestr(name, archive.read(own))
    return out


def maps(bundle, monkeypatch=None, bounds=None):
    """{solver: map} of one dV, with other bounds of what is shown."""
    if bounds is not None:
        monkeypatch.setattr(gentle, "SURE", bounds)
    buffers, found = Buffers(bundle), {}
    buffers.use_geometry(GeometryGraph(bundle).geometry(bent(), None, 1))
    buffers.change[0] = np.random.default_rng(5).normal(0, 0.1, 104)
    for one in engines(bundle, buffers):
        buffers.map[:] = 0.0
        one.infer()
        found[one.name] = buffers.map[0].copy()
    return found


def test_a_bundle_with_one_has_the_same_solvers_and_its_heads_pass_faint_frames_on(with_gentle, tiny, monkeypatch):
    bundle, plain = load_bundle(with_gentle), maps(tiny)
    assert solvers(bundle) == solvers(tiny)
    firm = maps(bundle, monkeypatch, (-2.0, -1.0))
    faint = maps(bundle, monkeypatch, (1e8, 2e8))
    for name in ("vd2t", "vd2t-int8"):
        assert np.array_equal(firm[name], plain[name])
        assert np.array_equal(faint[name], plain["vd2t-int8"]), "its head is the int8 one's here"
    assert np.array_equal(faint["tikhonov"], plain["tikhonov"])


def test_a_bundle_that_lacks_its_graphs_or_states_no_width_is_refused(with_gentle, tmp_path):
    for change, said in (
        (lambda manifest: manifest["files"].pop("gentle_head.onnx"), "lacks gentle_head.onnx"),
        (lambda manifest: manifest.update(gentle={"bias": 0}), "gentle bias is 0"),
        (lambda manifest: manifest.update(gentle=3), "gentle is "),
    ):
        path = changed(with_gentle, tmp_path / "b.eitskin", change)
        with pytest.raises(BundleError, match=said):
            load_bundle(path)
