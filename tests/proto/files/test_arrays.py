"""Arrays whose headers are damaged, or claim what is not there."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin_proto.files.arrays import pack_arrays, parse_npy, parse_npz, read_npz, save_arrays
from eitskin_proto.files.reading import FileError


def npy(array: Any) -> bytes:
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def with_header(text: str, data: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode("latin-1") + data


@pytest.mark.parametrize("kind", ["<f8", ">f4", "f2", "i4", "u1", "?", "c16", "U5", "S3"])
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3), (2, 0, 4), (1, 2, 3, 4)])
@pytest.mark.parametrize("order", ["C", "F"])
def test_what_numpy_writes_is_read_back(kind: str, shape: tuple[int, ...], order: Any) -> None:
    values = np.array(np.arange(np.prod(shape, dtype=int)).reshape(shape).astype(kind), order=order)
    found = parse_npy(npy(values))
    assert found.dtype == values.dtype
    np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x93NUMPY",
        b"PK\3\4" + bytes(100),
        with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000, 104), }", bytes(80)),
        with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (104,"),
        with_header("(" * 900),
        with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }"),
        with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (True,), }", bytes(8)),
        with_header("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", bytes(8)),
        with_header("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }", bytes(8)),
        with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (1,), 'more': 1}", bytes(8)),
        with_header("__import__('os').abort()"),
        with_header("\x00" * 64),
        npy(np.zeros(9))[:-1],
        npy(np.zeros(9)) + b"x",
    ],
)
def test_what_is_no_array_is_one_line(data: bytes) -> None:
    with pytest.raises(FileError) as caught:
        parse_npy(data, "a.npy")
    assert "a.npy" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_damaged_header_is_refused_or_reads_as_many_bytes() -> None:
    whole = npy(np.arange(6.0).reshape(2, 3))
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(3000):
        damaged = bytearray(whole)
        damaged[int(rng.integers(128))] ^= 1 << int(rng.integers(8))
        try:
            assert parse_npy(bytes(damaged)).nbytes == 48
        except FileError:
            refused += 1
    assert refused > 1000


def test_arrays_are_read_within_one_bound_together(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.zeros(1000), b=np.zeros(1000))
    assert set(read_npz(path, 20_000)) == {"a", "b"}
    with pytest.raises(FileError, match="claims 8128 bytes"):
        read_npz(path, 10_000)


def test_a_directory_of_many_members_is_refused_before_it_is_read() -> None:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for number in range(5000):
            archive.writestr(str(number), b"")
    with pytest.raises(FileError, match="lists 5000 members"):
        parse_npz(out.getvalue(), 1 << 20)


@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_holds_the_arrays_that_were_given_and_no_other(tmp_path, monkeypatch, compressed):
    """As with numpy 1.26 to 2.1, to which every keyword is an array."""
    name = "savez_compressed" if compressed else "savez"
    whole = getattr(np, name)

    def older(file, *arrays, **named):
        return whole(file, *arrays, **{key.replace("allow_pickle", "_allow_pickle"): one for key, one in named.items()})

    monkeypatch.setattr(np, name, older)
    with open(tmp_path / "a.npz", "wb") as stream:
        save_arrays(stream, {"a": np.arange(3), "told": "text"}, compressed=compressed)
    found = read_npz(tmp_path / "a.npz", 1 << 20)
    assert sorted(found) == ["a", "told"]
    assert str(found["told"]) == "text"


def test_arrays_of_objects_are_not_written():
    with pytest.raises(ValueError, match="array 'a' holds objects"):
        pack_arrays({"a": np.array([None])})
