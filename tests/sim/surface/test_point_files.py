"""Files of points: every form is read, and what is none is named."""

import struct

import numpy as np
import pytest

from eitskin_sim.surface.point_files import PointFileError, read_points
from eitskin_tools import cli


def write_ply(path, points, form):
    header = f"ply\nformat {form} 1.0\ncomment made by hand\nelement vertex {len(points)}\n"
    header += "property float x\nproperty double y\nproperty float z\nproperty uchar red\nelement face 1\n"
    header += "property list uchar int vertex_indices\nend_header\n"
    if form == "ascii":
        body = "".join(f"{x:.6f} {y:.6f} {z:.6f} 200\n" for x, y, z in points) + "3 0 1 2\n"
        path.write_bytes((header + body).encode())
        return
    order = "<" if "little" in form else ">"
    rows = b"".join(struct.pack(f"{order}fdfB", x, y, z, 200) for x, y, z in points)
    path.write_bytes(header.encode() + rows + struct.pack(f"{order}B3i", 3, 0, 1, 2))


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_files_of_all_three_forms_hold_the_same_points(tmp_path, form):
    points = np.random.default_rng(0).uniform(-200, 200, (50, 3))
    write_ply(tmp_path / "points.ply", points, form)
    assert np.allclose(read_points(tmp_path / "points.ply"), points, atol=2e-5)  # float32 of 200 mm


def pcd_head(count, form, fields="rgb x y z normal", sizes="4 4 8 4 4", types="U F F F F", counts="1 1 1 1 3"):
    return (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\n"
        f"COUNT {counts}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA {form}\n"
    ).encode()


def test_pcd_files_of_both_forms_hold_the_same_points(tmp_path):
    points = np.random.default_rng(0).uniform(-200, 200, (50, 3))
    points[7] = np.nan  # what a depth camera did not see
    rows = b"".join(struct.pack("<Ifdf3f", 200, x, y, z, 0.0, 0.0, 1.0) for x, y, z in points)
    (tmp_path / "binary.pcd").write_bytes(pcd_head(50, "binary") + rows)
    text = "".join(f"200 {x:.6f} {y:.6f} {z:.6f} 0 0 1\n" for x, y, z in points)
    (tmp_path / "text.pcd").write_bytes(pcd_head(50, "ascii") + text.encode())
    for name in ("binary.pcd", "text.pcd"):
        assert np.allclose(read_points(tmp_path / name), points, atol=2e-5, equal_nan=True)


def test_a_pcd_file_that_says_no_counts_has_one_number_a_field(tmp_path):
    head = pcd_head(2, "ascii", "x y z", "4 4 4", "F F F").replace(b"COUNT 1 1 1 1 3\n", b"")
    (tmp_path / "points.pcd").write_bytes(head + b"1 2 3\n4 5 6\n")
    assert read_points(tmp_path / "points.pcd").tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]


def test_text_and_array_files_are_read(tmp_path):
    points = np.random.default_rng(0).uniform(-200, 200, (50, 6))
    np.save(tmp_path / "points.npy", points.astype(np.float32))
    assert np.allclose(read_points(tmp_path / "points.npy"), points[:, :3], atol=2e-5)
    np.savetxt(tmp_path / "points.xyz", points, delimiter=",", header="x y z nx ny nz")
    assert np.allclose(read_points(tmp_path / "points.xyz"), points[:, :3])


BROKEN = {
    "empty.ply": b"",
    "no_end.ply": b"ply\nformat ascii 1.0\nelement vertex 3\n",
    "short.ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"end_header\n1 2 3\n",
    "cut.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    b"property float z\nend_header\n\0\0\0\0",
    "no_z.ply": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n",
    "empty.pcd": b"",
    "short.pcd": pcd_head(3, "ascii") + b"0 1 2 3 0 0 1\n",
    "cut.pcd": pcd_head(3, "binary") + bytes(95),
    "ragged.pcd": pcd_head(1, "ascii") + b"0 1 2\n",
    "compressed.pcd": pcd_head(1, "binary_compressed") + bytes(40),
    "no_z.pcd": pcd_head(1, "ascii", "x y w", "4 4 4", "F F F", "1 1 1") + b"1 2 3\n",
    "types.pcd": pcd_head(1, "binary", "x y z", "4 4 4", "F F Q", "1 1 1") + bytes(12),
    "counts.pcd": pcd_head(1, "binary", "x y z", "4 4 4", "F F F", "1 1 -1") + bytes(12),
    "huge.pcd": pcd_head(10**12, "binary", "x y z", "4 4 4", "F F F", "1 1 1") + bytes(12),
    "words.xyz": b"1 2 3\nfour five six\n",
    "ragged.xyz": b"1 2 3\n4 5\n",
    "binary.xyz": b"\xff\xfe\x00\x01",
    "pickle.npy": b"\x93NUMPY\x01\x00v\x00",
    "points.obj": b"v 1 2 3\n",
}


@pytest.mark.parametrize("name", BROKEN)
def test_unreadable_file_is_named_and_nothing_is_written(tmp_path, name, capsys):
    (tmp_path / name).write_bytes(BROKEN[name])
    with pytest.raises(PointFileError, match=name.replace(".", r"\.")):
        read_points(tmp_path / name)
    assert cli.main(["surface", str(tmp_path / name), "--out", str(tmp_path / "cloud.npz")]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.strip().splitlines()) == 1
    assert not (tmp_path / "cloud.npz").exists()
