"""Data sets: the same bits from any worker, resumable, and refused when they are not what they say."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from eitskin_proto.errors import MismatchError, ProtocolError
from eitskin_proto.files.arrays import pack_arrays, read_npz
from eitskin_proto.files.digest import sha256_of
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.dataset.generate import DataSetError, generate
from eitskin_sim.dataset.plan import make_plan
from eitskin_sim.dataset.reader import DataSet, load
from eitskin_sim.unit_grid.units import UnitGenerator

pytestmark = pytest.mark.heavy

PLAN = make_plan("paper", 0, deformations=2, touch_sets=20)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a small data set, made in this process."""
    out = tmp_path_factory.mktemp("data") / "paper"
    seen: list[tuple[int, int]] = []
    generate(PLAN, out, workers=0, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(0, 40), (20, 40), (40, 40)]
    return out


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


@pytest.fixture(scope="module")
def data(folder: Path) -> DataSet:
    return load(folder)


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_a_data_set_comes_back_with_all_that_training_needs(data: DataSet) -> None:
    assert data.voltages_V.shape == (40, 104)
    assert data.voltages_V.dtype == np.float32
    assert data.deformation.tolist() == [0] * 20 + [1] * 20
    assert data.touch_set.tolist() == list(range(20)) * 2
    assert data.clouds.shape == (2, 3, 30, 45)
    assert data.bends == PLAN.bends
    assert data.labels_kind == "units"
    assert len(data.rows(touches="train")) == 36
    assert len(data.rows(touches="validation")) == 4
    assert len(data.rows(deformations="kept", touches="all")) == 0
    assert not set(data.touch_set[data.rows(touches="train")]) & set(data.touch_set[data.rows(touches="validation")])


def test_labels_are_1_where_a_pixels_centre_is_touched(data: DataSet) -> None:
    labels = data.labels(np.array([0, 27]))
    assert labels.shape == (2, 30, 45)
    assert labels[0, 0, 0] == 1.0
    assert labels[0].sum() == 9.0
    assert np.array_equal(data.label_table_u8()[7].reshape(30, 45), 255 * labels[1])


# A finer mesh of the untouched sheet multiplies each deformation; ratios to it are the generator's own, to float32.
def test_voltages_are_the_generators_over_a_finer_untouched_sheet(data: DataSet) -> None:
    generator = UnitGenerator(PLAN.bends[1])
    expected = generator.voltages(data.units[[3]])[0] / generator.untouched_V
    assert data.voltages_V[23] / data.untouched_V[1] == pytest.approx(expected, rel=3e-7)
    assert data.untouched_V[1] == pytest.approx(generator.untouched_V, rel=5e-3)
    assert data.untouched_V[0] == pytest.approx(data.reference_V, rel=1e-12)
    assert np.abs(data.untouched_V[1] / data.reference_V - 1.0).max() > 0.05


@pytest.mark.process
def test_an_interrupted_run_goes_on_and_ends_the_same(folder: Path, copy: Path) -> None:
    (copy / "index.json").unlink()
    (copy / "deformation-0001.npz").unlink()
    with pytest.raises(ProtocolError, match=r"not a finished data set: index\.json is missing"):
        load(copy)
    done: list[int] = []
    generate(PLAN, copy, workers=1, progress=lambda now, total: done.append(now))
    assert done == [20, 40]
    assert files(copy) == files(folder)


def test_a_folder_with_something_else_in_it_is_left_alone(copy: Path, tmp_path: Path) -> None:
    with pytest.raises(DataSetError, match="holds another data set"):
        generate(make_plan("paper", 1, deformations=2, touch_sets=20), copy)
    strange = tmp_path / "letters"
    strange.mkdir()
    (strange / "dear.txt").write_text("x")
    with pytest.raises(DataSetError, match="not empty and is not a data set"):
        generate(PLAN, strange)
    assert [path.name for path in strange.iterdir()] == ["dear.txt"]


@pytest.mark.slow  # it is made once more
def test_a_folder_whose_first_file_was_cut_off_by_force_is_begun_again(copy: Path) -> None:
    made = {path.name: path.read_bytes() for path in copy.iterdir()}
    for path in copy.iterdir():
        path.unlink()
    (copy / ".plan.json.0123456789ab.part").write_bytes(b"{")

    def enough(done: int, _total: int) -> None:
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(PLAN, copy, workers=0, progress=enough)
    begun = {path.name: path.read_bytes() for path in copy.iterdir() if path.name in made}
    assert {"plan.json", "deformation-0000.npz"} <= set(begun)
    assert begun.items() <= made.items()


def test_a_file_that_changed_is_refused(copy: Path) -> None:
    path = copy / "deformation-0001.npz"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(MismatchError, match=r"deformation-0001.npz: sha256: found .* make it again"):
        load(copy)


@pytest.mark.parametrize(("name", "value"), [("protocol_id", PROTOCOL_ID), ("grid_id", PAPER.grid_id), ("version", 1)])
def test_a_foreign_data_set_is_refused_by_name(copy: Path, name: str, value: object) -> None:
    index = json.loads((copy / "index.json").read_text())
    index[name] = "0123"
    (copy / "index.json").write_text(json.dumps(index))
    with pytest.raises(MismatchError, match=f"{name}: found 0123, expected {value}"):
        load(copy)


def test_garbage_instead_of_an_index_is_refused(copy: Path) -> None:
    for garbage in (b"{", b"\xff\xfe", b"[]", b"[" * 100_000):
        (copy / "index.json").write_bytes(garbage)
        with pytest.raises(ProtocolError):
            load(copy)


def test_what_an_index_or_a_file_lacks_is_named_though_digests_are_right(copy: Path) -> None:
    path = copy / "index.json"
    whole = json.loads(path.read_text())
    path.write_text(json.dumps({key: value for key, value in whole.items() if key != "seed"}))
    with pytest.raises(ProtocolError, match="'seed' is missing; make it again with"):
        load(copy)
    arrays = read_npz(copy / "deformation-0000.npz", 1 << 24)
    content = pack_arrays({key: values for key, values in arrays.items() if key != "voltages"})
    (copy / "deformation-0000.npz").write_bytes(content)
    whole["deformations"][0]["sha256"] = sha256_of(content)
    path.write_text(json.dumps(whole))
    with pytest.raises(ProtocolError, match="'voltages' is missing; make it again with"):
        load(copy)


@pytest.mark.slow
def test_a_free_shard_holds_area_labels_of_its_own_touches(tmp_path: Path) -> None:
    plan = make_plan("free", 2, deformations=1, per_deformation=12, kept=0)
    index = generate(plan, tmp_path / "free", workers=0)
    data = load(tmp_path / "free")
    assert index["labels"] == data.labels_kind == "area"
    assert len(data.voltages_V) == 12
    labels = data.labels(np.arange(12))
    area = data.free.area_table().toarray()[data.touch_set[5]].reshape(30, 45)
    assert labels[5] == pytest.approx(np.minimum(area, 1.0), abs=1e-6)
    assert 0.0 < labels.mean() < 0.3
    table = data.label_table_u8()[data.touch_set].reshape(-1, 30, 45)
    assert np.abs(table / 255.0 - labels).max() <= 0.5 / 255 + 1e-6
