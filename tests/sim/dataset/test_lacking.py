"""A data set that lacks anything is refused in a line: each key of its index, each array of its files, one by one."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from eitskin_proto.errors import ProtocolError
from eitskin_proto.files.arrays import pack_arrays, read_npz
from eitskin_proto.files.digest import sha256_of
from eitskin_sim.dataset.generate import generate
from eitskin_sim.dataset.plan import make_plan
from eitskin_sim.dataset.reader import load

pytestmark = pytest.mark.heavy

SETS = {
    "presses of units": make_plan("units", 3, deformations=1, kept=0, touch_sets=10, touches="press"),
    "hard touches anywhere": make_plan("free", 2, deformations=1, per_deformation=12, kept=0),
}

UNREAD = {"skin_digest", "labels", "plan", "samples", "touch_sets", "made_again_by"}
"""Keys of an index that nobody needs; without the digest of its skin a data set is one of the paper's."""

SAID = {
    "format": "is no index of a data set",
    "version": "version: found None, expected",
    "protocol_id": "protocol_id: found None, expected",
    "grid_id": "grid_id: found None, expected",
    "skin": "index.json: ",
    "touch_kind": "version: found 2, expected 1",
    "deformations": "deformations found None, expected a list",
    "units": "with 0 touch sets and 10 that are told apart",
    "pieces": "the pieces of touches do not follow each other",
    "first": "the pieces of touches do not follow each other",
}
"""What is said of things other than that they are missing."""


@pytest.fixture(scope="module", params=SETS)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("data") / "set"
    generate(SETS[request.param], out, workers=0)
    return out


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copy"))


def part(index: Any, place: tuple[str | int, ...]) -> dict[str, Any]:
    for key in place:
        index = index[key]
    assert isinstance(index, dict)
    return index


def assert_refused(folder: Path, lacking: str) -> None:
    with pytest.raises(ProtocolError) as found:
        load(folder)
    said = str(found.value)
    assert SAID.get(lacking, f"{lacking!r} is missing; make it again with") in said
    assert "\n" not in said


@pytest.mark.parametrize("place", [(), ("touches",), ("deformations", 0)], ids=["top", "touches", "deformation"])
def test_an_index_without_one_of_its_keys_is_refused(folder: Path, place: tuple[str | int, ...]) -> None:
    path = folder / "index.json"
    whole = path.read_text()
    keys = list(part(json.loads(whole), place))
    assert len(keys) >= 2
    for key in keys:
        index = json.loads(whole)
        del part(index, place)[key]
        path.write_text(json.dumps(index))
        if key in UNREAD:
            load(folder)
        else:
            assert_refused(folder, key)


@pytest.mark.parametrize("name", ["touches.npz", "deformation-0000.npz"])
def test_a_file_without_one_of_its_arrays_is_refused_though_its_digest_is_right(folder: Path, name: str) -> None:
    index = json.loads((folder / "index.json").read_text())
    arrays = read_npz(folder / name, 1 << 24)
    assert len(arrays) >= 4
    for lacking in arrays:
        content = pack_arrays({key: values for key, values in arrays.items() if key != lacking})
        (folder / name).write_bytes(content)
        entry = index["touches"] if name == "touches.npz" else index["deformations"][0]
        entry["sha256"] = sha256_of(content)
        (folder / "index.json").write_text(json.dumps(index))
        assert_refused(folder, lacking)
