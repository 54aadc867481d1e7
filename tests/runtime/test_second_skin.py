"""The runtime on a skin that is not the paper's: everything follows the bundle's description."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.second_skin import SECOND, rolled

import eitskin
from eitskin.acquisition.capture import capture
from eitskin.errors import BundleError, ControlError, MismatchError
from eitskin.messaging.control import ControlServer
from eitskin.messaging.publish import Publisher
from eitskin.model.buffers import Buffers
from eitskin.model.bundle import load_bundle
from eitskin.model.engine import engines
from eitskin.model.geometry import GeometryGraph
from eitskin.model.skin_in_use import use_skin
from eitskin.reference import captured as references
from eitskin.reference.builder import ReferenceBuilder
from eitskin.skin import Skin
from eitskin_proto.skin.cloud_file import Surface, save_surface
from eitskin_proto.skin.parts import Layer, Map
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import to_toml
from eitskin_proto.wire import config_toml

PATH = Path(__file__).parents[1] / "golden" / "second.eitskin"
SHAPE = SECOND.grid.shape
OTHER = replace(SECOND, layer=Layer(gauge_factor=Quantity(1.0)))
MOVED = replace(SECOND, electrodes=replace(SECOND.electrodes, arc_length_mm=Quantity(tuple(SECOND.arc_length_mm + 1))))
KNOWN_BETTER = replace(OTHER, name="ours", calibrated_from=SECOND.digest)


@pytest.fixture(scope="module")
def second():
    return load_bundle(PATH)


def remade(path, change, files=None):
    """Write the bundle with some of its manifest or files changed; checksums follow."""
    from eitskin_proto.files.digest import sha256_of

    with zipfile.ZipFile(PATH) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()} | (files or {})
    manifest = json.loads(parts.pop("manifest.json")) | change
    manifest["files"] = {name: {"sha256": sha256_of(data)} for name, data in parts.items()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in {"manifest.json": json.dumps(manifest), **parts}.items():
            archive.writestr(name, data)
    return path


def test_a_bundle_carries_its_skin(second, tiny, tmp_path):
    assert second.skin == SECOND
    assert tiny.skin is PAPER
    assert second.tikhonov().shape == (18 * 45, 104)
    with pytest.raises(MismatchError, match=rf"skin_digest: found feed, expected {SECOND.digest}; .*eitskin export"):
        load_bundle(remade(tmp_path / "b.eitskin", {"skin_digest": "feed"}))
    with pytest.raises(MismatchError, match=rf"grid_id: found {PAPER.grid_id}, expected {SECOND.grid_id}"):
        load_bundle(remade(tmp_path / "b.eitskin", {"grid_id": PAPER.grid_id}))
    with pytest.raises(MismatchError, match=r"skin_digest: found None"):
        load_bundle(remade(tmp_path / "b.eitskin", {"skin_digest": None}))
    for text in (b"\xff", b"format = 1", b"x" * 2_000_000):
        with pytest.raises(BundleError, match=r"b\.eitskin: skin\.toml: .*; make it again with 'eitskin export'"):
            load_bundle(remade(tmp_path / "b.eitskin", {}, {"skin.toml": text}))


def test_a_description_must_be_of_the_bundle_s_sheet_or_that_sheet_calibrated(second, tmp_path):
    (tmp_path / "skin.toml").write_text(to_toml(SECOND))
    assert use_skin(second, None) is second.skin
    assert use_skin(second, tmp_path / "skin.toml") == SECOND
    assert use_skin(second, KNOWN_BETTER) is KNOWN_BETTER
    assert use_skin(second, OTHER) is OTHER
    with pytest.raises(MismatchError, match=r"grid_id: found .*, expected .*eitskin build"):
        use_skin(second, PAPER)
    with pytest.raises(MismatchError, match=r"sheet and map: found .*\(18, 45\).* expected .*\(20, 50\)"):
        use_skin(second, replace(KNOWN_BETTER, map=Map((20, 50), (2, 2))))


def test_every_solver_fills_its_map(second):
    buffers = Buffers(second)
    buffers.use_geometry(GeometryGraph(second).geometry(rolled(SECOND, 60.0), None, 1))
    buffers.change[:] = np.random.default_rng(2).normal(0, 0.1, (1, 104))
    for engine in engines(second, buffers):
        buffers.map[:] = 0.0
        engine.infer()
        assert buffers.map.shape == (1, 810)
        assert buffers.map.any()


def test_a_reference_of_another_skin_is_refused(hello, counts, tmp_path):
    builder = ReferenceBuilder(2, SECOND)
    rng = np.random.default_rng(0)
    for _ in range(2):
        builder.add(1e-9 * counts * (1 + 1e-3 * rng.standard_normal(104)))
    path = tmp_path / "reference.json"
    references.save(builder.finish(hello), path)
    assert references.load(path, SECOND).skin_digest == SECOND.digest
    references.load(path, KNOWN_BETTER).check_skin(KNOWN_BETTER)
    references.load(path)  # to be shown
    references.load(path, OTHER).check_skin(OTHER)
    for wrong in (PAPER, MOVED):
        with pytest.raises(MismatchError, match=rf"{path}: grid_id: found .*, expected .*eitskin reference --port"):
            references.load(path, wrong)
        with pytest.raises(MismatchError, match=r"grid_id: found .*, expected .*eitskin reference --port"):
            references.load(path).check_skin(wrong)


@pytest.mark.process
def test_a_whole_stream_of_another_skin(virtual_skin, tmp_path):
    saved = tmp_path / "reference.json"
    with virtual_skin(touches=[[0.0, 60.0, 0.3]]) as port, Skin(port, bundle=PATH, skin=KNOWN_BETTER) as skin:
        skin.capture_reference(10, force=True)
        references.save(skin.reference, saved)
        assert skin.reference.skin_digest == KNOWN_BETTER.digest
        assert skin.status()["skin"] == f"ours/{KNOWN_BETTER.digest}"
        frame = next(skin.frames(timeout_s=60))
        assert frame.map.shape == SHAPE
        publisher = Publisher(f"ipc://{tmp_path}/frames")
        control = ControlServer(f"ipc://{tmp_path}/control", skin)
        try:
            save_surface(tmp_path / "cloud.npz", Surface(rolled(SECOND, 40.0)), skin=SECOND)
            assert eitskin.send_cloud(control.endpoint, tmp_path / "cloud.npz", skin=SECOND) == 1
            assert eitskin.send_cloud(control.endpoint, rolled(SECOND, 40.0), skin=KNOWN_BETTER) == 2
            assert eitskin.send_cloud(control.endpoint, rolled(SECOND, 40.0), skin=OTHER) == 3
            with pytest.raises(ControlError, match=rf"grid_id: found {MOVED.grid_id}, expected .*eitskin surface"):
                eitskin.send_cloud(control.endpoint, rolled(SECOND, 40.0), skin=MOVED)
            with pytest.raises(ControlError, match=r"cloud is 16200 bytes, expected 9720 bytes of <f4 \(3, 18, 45\)"):
                eitskin.send_cloud(control.endpoint, PAPER.grid.flat_cloud_mm())
            with pytest.raises(MismatchError, match="grid_id"):
                eitskin.send_cloud(control.endpoint, tmp_path / "cloud.npz")
        finally:
            control.close()
            publisher.close()
    with pytest.raises(MismatchError, match=r"grid_id: found .*eitskin reference"):
        Skin("/dev/none", reference=saved)


@pytest.mark.process
def test_a_device_that_states_its_skin_is_taken_for_no_other(virtual_skin, tmp_path):
    stated = replace(config_toml.named("paper"), skin=SECOND.digest)
    (tmp_path / "device.toml").write_text(config_toml.to_toml(stated))
    with virtual_skin(configuration=str(tmp_path / "device.toml")) as port:
        for skin in (None, KNOWN_BETTER):
            with Skin(port, bundle=PATH, skin=skin) as found:
                assert found.device.hello.skin_digest == SECOND.digest
        with pytest.raises(MismatchError, match=rf"found {SECOND.digest}, expected {PAPER.grid_id} .*--bundle.*flash"):
            Skin(port)
        with pytest.raises(MismatchError, match=rf"the device's skin: found {SECOND.digest}"):
            capture(port, 10)
