"""A bundle with two networks: the smaller one is a solver of its own, between the larger one's and the matrix."""

import json
import zipfile

import numpy as np
import pytest

from eitskin.errors import BundleError
from eitskin.model.buffers import Buffers
from eitskin.model.bundle import graphs_of, load_bundle
from eitskin.model.engine import VD2T_SMALL, default_solver, engines, solvers
from eitskin.model.geometry import GeometryGraph
from eitskin_proto.skin.cloud import flat_cloud

ALL = ["vd2t", "vd2t-int8", VD2T_SMALL, "tikhonov"]


def changed(path, out, change):
    """Write a bundle with another manifest."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    manifest = json.loads(parts["manifest.json"])
    change(manifest)
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in {**parts, "manifest.json": json.dumps(manifest).encode()}.items():
            archive.writestr(name, data)
    return out


def maps(bundle, cloud=None, forget=None):
    """Return {solver: map} of one dV; the bias of the network ``forget`` is 0; the bundle's own is ""."""
    buffers = Buffers(bundle)
    buffers.use_geometry(GeometryGraph(bundle).geometry(cloud, None, 1))
    buffers.change[0] = np.random.default_rng(5).normal(0, 0.1, 104)
    if forget is not None:
        buffers.beside.get(forget, buffers.bias)[:] = 0.0
    found = {}
    for engine in engines(bundle, buffers):
        engine.infer()
        found[engine.name] = buffers.map[0].copy()
    return found


def bent():
    cloud = flat_cloud()
    cloud[2] = 4.0 * np.sin(cloud[0] / 30)
    return cloud


def test_the_smaller_network_is_a_solver_before_the_matrix(tiny, paired):
    assert solvers(paired) == ALL
    assert solvers(tiny) == ["vd2t", "vd2t-int8", "tikhonov"]
    assert default_solver(paired) == default_solver(tiny)  # a stream without a budget is the same as before


def test_its_maps_are_of_its_own_graphs_and_of_its_own_half_of_the_geometry(paired):
    found = maps(paired, bent())
    assert np.array_equal(found[VD2T_SMALL], found["vd2t-int8"])  # the same graphs, in this bundle
    without_own, without_others = maps(paired, bent(), "small"), maps(paired, bent(), "")
    assert np.array_equal(without_own["vd2t-int8"], found["vd2t-int8"])
    assert not np.array_equal(without_own[VD2T_SMALL], found[VD2T_SMALL])
    assert np.array_equal(without_others[VD2T_SMALL], found[VD2T_SMALL])
    assert not np.array_equal(without_others["vd2t-int8"], found["vd2t-int8"])


@pytest.mark.parametrize("name", graphs_of("small"))
def test_a_bundle_that_lacks_one_of_its_graphs_is_refused(paired_path, tmp_path, name):
    path = changed(paired_path, tmp_path / "b.eitskin", lambda manifest: manifest["files"].pop(name))
    with pytest.raises(BundleError, match=f"lacks {name}"):
        load_bundle(path)
