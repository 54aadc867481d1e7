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
from eitskin.model.gentle import EDGES_PX, SHOWN_BOUNDS_MM2, GentleEngine, edges_px
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


def blob(side_px, width_px, at=(15.0, 22.0)):
    """A map of a square touch whose edges are logistic."""
    found = 1.0
    for axis, (count, middle) in enumerate(zip(GRID.shape, at, strict=True)):
        inside = side_px / 2 - np.abs(np.arange(count) + 0.5 - middle)
        found = found * np.expand_dims(1.0 / (1.0 + np.exp(-inside / width_px)), 1 - axis)
    return found.astype(np.float32)


def test_a_firm_touch_with_wide_edges_is_drawn_by_the_network_that_shows_it_much_larger():
    own, other = blob(4.0, 0.5), blob(6.0, 0.3)
    assert edges_px(own) > EDGES_PX[1]
    one, whole, ran = engine(own, other)
    one.infer()
    assert one.shown_mm2() > SHOWN_BOUNDS_MM2[1], "it is firm"
    assert ran == ["own", "gentle"]
    np.testing.assert_allclose(whole, other.ravel(), atol=1e-6)


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
        monkeypatch.setattr(gentle, "SHOWN_BOUNDS_MM2", bounds)
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
