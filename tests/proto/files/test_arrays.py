"""Arrays whose headers are damaged, or claim what is not there."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin_proto.files.arrays import numbers, parse_npy, parse_npz, read_npz, text
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
    with pytest.raises(FileError, match="has 8128 bytes by its header"):
        read_npz(path, 10_000)


def test_a_directory_of_many_members_is_refused_before_it_is_read() -> None:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for number in range(5000):
            archive.writestr(str(number), b"")
    with pytest.raises(FileError, match="lists 5000 members"):
        parse_npz(out.getvalue(), 1 << 20)


@pytest.mark.parametrize(
    ("given", "shape", "message"),
    [
        (np.ones(3, complex), None, "a holds complex128, expected real numbers"),
        (np.array(["x"]), None, "a holds <U1, expected real numbers"),
        (np.array([True]), None, "a holds bool, expected real numbers"),
        (np.ones((2, 3)), (None, 4), r"a has shape \(2, 3\), expected \(n, 4\)"),
        (np.ones(3), (4,), r"a has shape \(3,\), expected \(4,\)"),
        (np.ones(3), (3, 1), r"a has shape \(3,\), expected \(3, 1\)"),
        (np.array([[1.0, 2.0], [np.nan, np.inf]]), None, r"a\[1, 0\] is nan, expected finite numbers; 2 are not"),
        (np.array(np.inf), (), r"a\[\] is inf"),
    ],
)
def test_what_is_no_such_array_is_named(given, shape, message):
    with pytest.raises(ValueError, match=message):
        numbers({"a": given}, "a", shape)


@pytest.mark.parametrize("given", [np.array("grün"), np.array(["grün"]), np.array("grün".encode())])
def test_a_text_is_taken_as_it_was_saved(given):
    assert text({"a": given}, "a") == "grün"
