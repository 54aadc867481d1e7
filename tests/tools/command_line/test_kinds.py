"""A file of another kind than a command writes is never replaced: a slip of the name would lose a day's recording."""

import io
import json
import zipfile
from importlib import resources

import numpy as np
import pytest
from tests.tools.command_line.test_files import WRITING, WRITING_WITH_TORCH, said, taken

from eitskin_proto.configurations import __name__ as configurations
from eitskin_proto.files.reading import FileError
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.cloud_file import Surface, save_surface
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import to_toml
from eitskin_tools.command_line import kinds


def arrays(*names):
    stream = io.BytesIO()
    np.savez(stream, **{name: np.zeros(2) for name in names})
    return stream.getvalue()


def cloud(folder):
    save_surface(folder / "made.npz", Surface(flat_cloud()))
    return (folder / "made.npz").read_bytes()


def array():
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    return stream.getvalue()


def archive(name):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        file.writestr(name, "{}")
    return stream.getvalue()


FILES = {
    kinds.REFERENCE: json.dumps({"format": "eitskin-reference", "version": 1}, indent=1).encode()[:-9],
    kinds.SKIN: b"# a sheet\n\n" + to_toml(PAPER).encode(),
    kinds.RECIPE: b'format = "eitskin-recipe"\n',
    kinds.ROBOT: b'# an arm\n[[skins]]\nname = "elbow"\n',
    kinds.CONFIGURATION: resources.files(configurations).joinpath("paper.toml").read_bytes(),
    kinds.BUNDLE: archive("manifest.json"),
    kinds.VOLTAGES: arrays("voltages", "voltages208", "scene"),
    kinds.GUIDED: arrays("reference_V", "reference_frames", "press_V"),
    kinds.DEMO_RECORD: arrays("received_ns", "scalars"),
    kinds.CONVERTED: arrays("voltages_V", "reference_V", "serial", "map", "solver", "wall_ns"),
    kinds.COMPUTED: arrays("seq", "map", "solver", "wall_ns"),
    kinds.PARQUET: b"PAR1\0\0",
    kinds.RECORDING: b'\x89MCAP0\r\n{"format": "eitskin-reference"',
    kinds.PICTURE: b'<?xml version="1.0"?>\n<!DOCTYPE svg PUBLIC "x">\n<svg xmlns="x">',
    kinds.ARRAY: array(),
    kinds.LOG: b'{"event": "boot", "host_ns": 1}\n',
    kinds.POINTS: b"ply\nformat ascii 1.0\n",
    kinds.OTHER_ARCHIVE: arrays("anything"),
    kinds.OTHER_JSON: b'[\n{"phantom": 1}]',
    None: b"a letter to somebody",
}
"""Kind -> the beginning of such a file, which is often all that there is."""

ALL = {**FILES, kinds.CLOUD: b""}


def name_of(kind):
    return "unknown" if kind is None else kind.what


@pytest.mark.parametrize("kind", ALL, ids=name_of)
def test_a_file_is_known_by_what_it_holds(kind, tmp_path):
    path = tmp_path / "whatever.json"
    path.write_bytes(FILES[kind] if kind in FILES else cloud(tmp_path))
    assert kinds.kind_of_file(path) is kind


@pytest.mark.parametrize(
    "command", sorted((WRITING | WRITING_WITH_TORCH).keys() - {"record"})
)  # which replaces nothing at all
def test_a_file_of_another_kind_stays_as_it_is(command, tmp_path, capsys):
    path = tmp_path / "out.png"
    path.write_bytes(FILES[kinds.ROBOT])
    words = [*taken(command), str(path)]
    found = said(capsys, [*words, *(["--force"] if command == "reference" else [])])
    assert f"{path} is a robot's list of skins, expected " in found
    assert "to replace, or a new name; name another, or move it away" in found
    assert path.read_bytes() == FILES[kinds.ROBOT]


@pytest.mark.parametrize("kind", [kind for kind in FILES if kind is not kinds.REFERENCE], ids=name_of)
def test_a_reference_replaces_references_alone_and_what_is_empty(kind, tmp_path):
    path = tmp_path / "reference.json"
    kinds.check_replaced(path, kinds.REFERENCE)
    for content in (b"", FILES[kinds.REFERENCE]):
        path.write_bytes(content)
        kinds.check_replaced(path, kinds.REFERENCE)
    path.write_bytes(FILES[kind])
    with pytest.raises(FileError, match="expected a reference to replace"):
        kinds.check_replaced(path, kinds.REFERENCE)
