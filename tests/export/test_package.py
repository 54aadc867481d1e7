import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.second_skin import SECOND

from eitskin.model.bundle import load_bundle
from eitskin_export import bundle, package, parity
from eitskin_proto.errors import SkinError
from eitskin_proto.skin.skin import PAPER
from eitskin_training import run_files, train
from eitskin_training.gate.untouched import bends_of
from eitskin_training.recipes import recipe
from eitskin_training.samples.batches import TrainingData

pytestmark = pytest.mark.heavy

PROJECTION = np.zeros((1350, 104), dtype=np.float32)
JACOBIAN = np.random.default_rng(0).standard_normal((104, 1350))


@pytest.fixture(scope="module")
def data(toy_data: Any) -> TrainingData:
    made: TrainingData = toy_data("area", bends=12, samples=1200)
    return made


@pytest.fixture(scope="module")
def run(data: TrainingData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("run")
    train.train(data, replace(recipe("tiny"), epochs=1), folder, seed=3)
    return folder


@pytest.fixture(scope="module")
def exported(run: Path, data: TrainingData, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    out: Path = tmp_path_factory.mktemp("bundle") / "toy.eitskin"
    return out, package.export(run_files.trained(run), data, out, jacobian=lambda skin: JACOBIAN, bends=bends_of)


@pytest.mark.slow
def test_the_bundle_is_what_the_runtime_reads(exported: tuple[Path, dict[str, Any]]) -> None:
    path, result = exported
    loaded = load_bundle(path)
    assert loaded.id == result["bundle"]
    assert loaded.labels == "area"
    assert loaded.uses_prediction
    assert set(loaded.files) == {
        "geometry.onnx",
        "head.onnx",
        "head_int8.onnx",
        "tikhonov.npy",
        "gate.npz",
        "consistency.npz",
        "skin.toml",
    }
    assert result["parity"]["map through the runtime"] < parity.TOLERANCE


@pytest.mark.slow
def test_a_bundle_of_another_skin_carries_it_and_runs(toy_data: Any, tmp_path: Path) -> None:
    data = replace(toy_data("area", bends=12, samples=1200, skin=SECOND), touch_kind="lower")
    train.train(data, replace(recipe("tiny"), epochs=1), tmp_path / "run")
    out = tmp_path / "second.eitskin"
    found = run_files.trained(tmp_path / "run")
    result = package.export(found, data, out, bends=bends_of)
    loaded = load_bundle(out)
    assert loaded.skin == SECOND
    assert loaded.touch_kind == result["touches"] == "lower"
    assert (loaded.manifest["grid_id"], loaded.manifest["skin_digest"]) == (SECOND.grid_id, SECOND.digest)
    assert loaded.tikhonov().shape == (SECOND.grid.n_pixels, 104)
    assert result["parity"]["map through the runtime"] < parity.TOLERANCE
    files, facts, skin = bundle.read(out)
    assert skin == SECOND
    assert not {"skin.toml", "skin_digest"} & ({*files} | {*facts})
    assert bundle.write(tmp_path / "again.eitskin", files, facts, skin) == loaded.id


def test_the_same_contents_give_the_same_file(tmp_path: Path) -> None:
    files, facts = {"a.bin": b"1234", "b.bin": b""}, {"labels": "area"}
    identities = [bundle.write(tmp_path / name, files, facts, PAPER) for name in ("one", "two")]
    assert identities[0] == identities[1]
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    with zipfile.ZipFile(tmp_path / "one") as archive:
        assert all(item.compress_type == zipfile.ZIP_STORED for item in archive.infolist())
        assert json.loads(archive.read("manifest.json"))["files"]["a.bin"]["bytes"] == 4


def test_a_projection_of_another_shape_or_with_holes_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected \(1350, 104\)"):
        bundle.projection_bytes(PROJECTION.T, PAPER.grid)
    with pytest.raises(ValueError, match="finite"):
        bundle.projection_bytes(np.full((1350, 104), np.nan), PAPER.grid)


@pytest.mark.slow
def test_a_card_grows_without_touching_the_graphs(exported: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    path, result = exported
    copy = tmp_path / "copy.eitskin"
    copy.write_bytes(path.read_bytes())
    identity = bundle.amend(copy, {"phantoms": {"one": 1.0}})
    before, after = load_bundle(path), load_bundle(copy)
    assert after.id == identity != result["bundle"]
    assert after.files == before.files
    assert after.manifest["metrics"] == {**before.manifest["metrics"], "phantoms": {"one": 1.0}}


@pytest.mark.slow
def test_a_changed_bundle_is_not_amended(exported: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    files, facts, skin = bundle.read(exported[0])
    broken = tmp_path / "broken.eitskin"
    bundle.write(broken, files, facts, skin)
    content = bytearray(broken.read_bytes())
    at = content.index(files["tikhonov.npy"])
    content[at + 200] ^= 1
    broken.write_bytes(content)
    with pytest.raises(SkinError):
        bundle.amend(broken, {})
    (tmp_path / "text.eitskin").write_text("no bundle")
    with pytest.raises(SkinError, match="is not an intact bundle"):
        bundle.read(tmp_path / "text.eitskin")
