import hashlib
import io
import json
import zipfile

import numpy as np
import pytest

from eitskin.errors import BundleError, MismatchError
from eitskin.model.bundle import load_bundle
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER


def parts_of(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write(path, parts, manifest=None, *, checksums=False):
    entries = dict(parts)
    if manifest is not None:
        entries["manifest.json"] = json.dumps(manifest).encode()
    if checksums:
        known = json.loads(entries["manifest.json"])
        for name in known["files"]:
            known["files"][name]["sha256"] = hashlib.sha256(entries[name]).hexdigest()
        entries["manifest.json"] = json.dumps(known).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return path


@pytest.fixture
def parts(tiny_path):
    return parts_of(tiny_path)


@pytest.fixture
def manifest(parts):
    return json.loads(parts["manifest.json"])


def test_a_bundle_is_read_whole_and_its_id_is_its_manifest(tiny_path, parts):
    bundle = load_bundle(tiny_path)
    assert bundle.id == hashlib.sha256(parts["manifest.json"]).hexdigest()[:16]
    assert bundle.tikhonov().shape == (1350, 104)
    assert bundle.bias_width == 8
    assert bundle.uses_prediction
    assert bundle.labels == "area"
    assert set(bundle.gate_arrays()) >= {"w1", "threshold"}


def test_a_bundle_that_is_not_there_is_said_with_those_that_are(tmp_path):
    with pytest.raises(BundleError, match="one of the shipped: free, press, units; 'eitskin b"):
        load_bundle(tmp_path / "fre")


@pytest.mark.parametrize("name", ["geometry.onnx", "head.onnx", "head_int8.onnx", "tikhonov.npy", "gate.npz"])
def test_one_changed_byte_in_any_file_is_found_and_named(tmp_path, parts, name):
    damaged = bytearray(parts[name])
    damaged[len(damaged) // 2] ^= 1
    path = write(tmp_path / "b.eitskin", parts | {name: bytes(damaged)})
    with pytest.raises(BundleError, match=rf"{name}.*found.*expected.*eitskin export"):
        load_bundle(path)


@pytest.mark.parametrize(
    ("key", "expected"),
    [("protocol_id", PROTOCOL_ID), ("grid_id", PAPER.grid_id), ("skin_digest", PAPER.digest), ("version", 1)],
)
def test_a_bundle_for_something_else_is_refused_with_found_expected_and_command(
    tmp_path, parts, manifest, key, expected
):
    path = write(tmp_path / "b.eitskin", parts, manifest | {key: "feedfeedfeedfeed"})
    with pytest.raises(MismatchError) as caught:
        load_bundle(path)
    text = str(caught.value)
    assert key in text
    assert "found feedfeedfeedfeed" in text
    assert f"expected {expected}" in text
    assert "eitskin export" in text


def test_files_that_are_no_bundles_are_refused_in_one_line(tmp_path, parts):
    missing = tmp_path / "none.eitskin"
    text = tmp_path / "text.eitskin"
    text.write_text("hello")
    empty = write(tmp_path / "empty.eitskin", {})
    no_json = write(tmp_path / "nojson.eitskin", parts | {"manifest.json": b"{"})
    other = write(tmp_path / "other.eitskin", parts, {"format": "zip"})
    for path in (missing, text, empty, no_json, other, tmp_path):
        with pytest.raises(BundleError) as caught:
            load_bundle(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_every_shortened_bundle_is_refused(tmp_path, tiny_path):
    whole = tiny_path.read_bytes()
    path = tmp_path / "short.eitskin"
    for length in range(0, len(whole), 499):
        path.write_bytes(whole[:length])
        with pytest.raises(BundleError):
            load_bundle(path)


def test_a_pickled_array_is_refused_not_executed(tmp_path, parts):
    class Bomb:
        def __reduce__(self):
            return (exec, ("raise SystemExit('executed')",))

    stream = io.BytesIO()
    np.save(stream, np.array([Bomb()], dtype=object), allow_pickle=True)
    bundle = load_bundle(write(tmp_path / "b.eitskin", parts | {"tikhonov.npy": stream.getvalue()}, checksums=True))
    with pytest.raises(BundleError, match="pickle"):
        bundle.tikhonov()


@pytest.mark.parametrize("matrix", [np.zeros((104, 1350), np.float32), np.full((1350, 104), np.nan, np.float32)])
def test_a_projection_of_the_wrong_shape_or_with_nan_is_refused(tmp_path, parts, matrix):
    stream = io.BytesIO()
    np.save(stream, matrix)
    bundle = load_bundle(write(tmp_path / "b.eitskin", parts | {"tikhonov.npy": stream.getvalue()}, checksums=True))
    with pytest.raises(BundleError, match=r"tikhonov\.npy"):
        bundle.tikhonov()


@pytest.mark.parametrize(
    "change", [{"labels": []}, {"gate": "abc"}, {"metrics": [1]}, {"head": {"inputs": 1, "bias": 2}}]
)
def test_a_manifest_of_other_types_is_refused_in_a_line(tmp_path, parts, manifest, change):
    path = write(tmp_path / "b.eitskin", parts, manifest | change)
    with pytest.raises(BundleError) as caught:
        load_bundle(path)
    assert str(caught.value).isprintable()


def without_network(parts, manifest):
    kept = ("tikhonov.npy", "gate.npz")
    manifest = {key: value for key, value in manifest.items() if key != "head"}
    manifest["files"] = {name: manifest["files"][name] for name in kept}
    return {name: parts[name] for name in kept}, manifest


def test_a_bundle_without_a_network_has_its_matrix_and_places_clouds(tmp_path, parts, manifest, tiny):
    from eitskin.model.buffers import Buffers
    from eitskin.model.engine import engines
    from eitskin.model.geometry import GeometryGraph

    bundle = load_bundle(write(tmp_path / "b.eitskin", *without_network(parts, manifest)))
    found, expected = Buffers(bundle), Buffers(tiny)
    found.use_geometry(GeometryGraph(bundle).geometry(None, None, 0))
    found.change[:] = expected.change[:] = np.linspace(-0.1, 0.1, 104)
    (only,) = engines(bundle, found)
    only.infer()
    engines(tiny, expected, best="tikhonov")[0].infer()
    assert only.name == "tikhonov"
    np.testing.assert_array_equal(found.map, expected.map)


def test_a_bundle_without_any_solver_is_refused(tmp_path, parts, manifest):
    files, manifest = without_network(parts, manifest)
    manifest["files"].pop("tikhonov.npy")
    with pytest.raises(BundleError, match="no solver: expected a network"):
        load_bundle(write(tmp_path / "b.eitskin", files, manifest))
