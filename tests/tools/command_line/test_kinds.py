"""A file of another kind than a command writes is never replaced: a slip of the name would lose a day's recording."""

import io
import json
import re
import zipfile

import numpy as np
import pytest
from tests.tools.command_line.test_files import WRITING, WRITING_WITH_TORCH, said, taken

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


def array():
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    return stream.getvalue()


def archive(name):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        file.writestr(name, "{}")
    return stream.getvalue()


OTHERS = {
    kinds.REFERENCE: json.dumps({"format": "eitskin-reference", "version": 1}, indent=1).encode()[:-9],
    kinds.SKIN: b"# a sheet\n\n" + to_toml(PAPER).encode(),
    kinds.BUNDLE: archive("manifest.json"),
    kinds.VOLTAGES: arrays("voltages", "voltages208", "scene"),
    kinds.GUIDED: arrays("reference_V", "reference_frames", "press_V"),
    kinds.PRESSES: arrays("xy_mm", "size_mm", "voltages_V"),
    kinds.CONVERTED: arrays("voltages_V", "reference_V", "serial", "map", "solver", "wall_ns"),
    kinds.COMPUTED: arrays("seq", "map", "solver", "wall_ns"),
    kinds.PARQUET: b"PAR1\0\0",
    kinds.RECORDING: b'\x89MCAP0\r\n{"format": "eitskin-reference"',
    kinds.PICTURE: b'<?xml version="1.0"?>\n<!DOCTYPE svg PUBLIC "x">\n<svg xmlns="x">',
    kinds.ARRAY: array(),
    kinds.LOG: b'{"event": "boot", "host_ns": 1}\n',
    "a robot's skins": b'# an arm\n[[skins]]\nname = "elbow"\n',
    "a recipe": b'format = "eitskin-recipe"\n',
    "arrays": arrays("anything"),
    "a list": b'[\n{"phantom": 1}]',
    "a letter": b"a letter to somebody",
}
"""Kind -> the beginning of such a file, which is often all that there is; by a name, what no command writes."""


@pytest.mark.parametrize("kind", [kind for kind in OTHERS if not isinstance(kind, str)], ids=lambda kind: kind.what)
def test_a_file_is_replaced_by_its_own_kind_and_no_other(kind, tmp_path):
    path = tmp_path / "whatever.json"
    for other, content in {kind: b"", **OTHERS}.items():
        path.write_bytes(content)
        if other is kind or not content:
            kinds.check_replaced(path, kind)
        else:
            with pytest.raises(FileError, match=f"something other than {re.escape(kind.what)}"):
                kinds.check_replaced(path, kind)


def test_a_cloud_is_known_by_its_arrays(tmp_path):
    save_surface(tmp_path / "made.npz", Surface(flat_cloud()))
    kinds.check_replaced(tmp_path / "made.npz", kinds.CLOUD)


@pytest.mark.parametrize(
    "command", sorted((WRITING | WRITING_WITH_TORCH).keys() - {"record"})
)  # which replaces nothing at all
def test_a_file_of_another_kind_stays_as_it_is(command, tmp_path, capsys):
    path = tmp_path / "out.png"
    path.write_bytes(b"a letter to somebody")
    words = [*taken(command), str(path)]
    found = said(capsys, [*words, *(["--force"] if command == "reference" else [])])
    assert f"{path} holds something other than " in found
    assert "which would be lost; name another file, or move it away" in found
    assert path.read_bytes() == b"a letter to somebody"
