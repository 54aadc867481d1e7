"""Files of points: every form is read, and what is none is named."""

import io
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


def array_file(values):
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


PLY = "ply\nformat {form} 1.0\ncomment Jörg\n{first}element vertex 3\n"
PLY += "property float x\nproperty float y\nproperty float z\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"
LISTS = "property list uchar int rays\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"


def ply_with_lists(lengths, faces_first=False):
    head = PLY.format(form="binary_little_endian", first=FACES if faces_first else "") + LISTS
    rows = [struct.pack(f"<3fB{n}i", *point, n, *range(n)) for point, n in zip(POINTS, lengths, strict=True)]
    return head.encode("latin-1") + (struct.pack("<B3i", 3, 0, 1, 2) if faces_first else b"") + b"".join(rows)


def stl_of(corners):
    return bytes(80) + struct.pack("<I", 1) + struct.pack("<12fH", 0, 0, 1, *np.ravel(corners), 0)


def compressed_pcd(*packed):
    body = b"".join(packed)
    head = pcd_head(3, "binary_compressed", "intensity x y z", "4 4 4 4", "F F F F", "1 1 1 1")
    return head + struct.pack("<II", len(body), 48) + body


POINTS = [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5], [7.5, 8.5, 9.5]]
FIELDS = np.array(POINTS).T.astype("<f4").tobytes()  # as the body of a compressed file: all x, all y, all z
AS_WRITTEN = {
    "blank.ply": (
        PLY.format(form="ascii", first="") + "end_header\n\n1.5 2.5 3.5\n4.5 5.5 6.5\n7.5 8.5 9.5\n"
    ).encode(),
    "same_lists.ply": ply_with_lists([2, 2, 2]),
    "blank_line.ply": (PLY.format(form="binary_little_endian", first="") + "end_header\n\n").encode()
    + np.array(POINTS, "<f4").tobytes(),
    "lists.ply": ply_with_lists([0, 2, 1]),
    "faces_first.ply": ply_with_lists([0, 2, 1], faces_first=True),
    "old_mac.ply": (PLY.format(form="binary_little_endian", first="") + "end_header\n").replace("\n", "\r").encode()
    + np.array(POINTS, "<f4").tobytes(),
    # A run of 1 byte and a copy of 11 from 1 byte before; then a run of 32 and one of 4 bytes.
    "packed.pcd": compressed_pcd(b"\0\0", b"\xe0\2\0", b"\x1f" + FIELDS[:32], b"\3" + FIELDS[32:]),
    "no_counts.pcd": pcd_head(3, "ascii", "x y z", "4 4 4", "F F F").replace(b"COUNT 1 1 1 1 3\n", b"")
    + b"1.5 2.5 3.5\n4.5 5.5 6.5\n7.5 8.5 9.5\n",
    "header.xyz": b"X Y Z\n1.5 2.5 3.5\n4.5 5.5 6.5\n7.5 8.5 9.5\n",
    "remark.asc": b"//Z X Y\n3.5 1.5 2.5\n6.5 4.5 5.5\n9.5 7.5 8.5\n",
    "latin.txt": "# von Jörg\n1.5 2.5 3.5\n4.5 5.5 6.5\n\n7.5 8.5 9.5\n".encode("latin-1"),
    "semicolons.txt": b"; by hand\n1.5;2.5;3.5;\n4.5;5.5;6.5;\n;\n7.5;8.5;9.5;\n",
    "behind.txt": b"sep=;\n1.5 2.5 3.5 # first\n4.5 5.5 6.5\n7.5 8.5 9.5 // last\n",
    "atoms.xyz": b"3\nframe 0\nC 1.5 2.5 3.5\nC 4.5 5.5 6.5\nH 7.5 8.5 9.5\n",
    "index.csv": b",x,y,z\n0,1.5,2.5,3.5\n1,4.5,5.5,6.5\n2,7.5,8.5,9.5\n",
    "count.pts": b"3\r\n1.5 2.5 3.5 200\r\n4.5 5.5 6.5 100\r\n7.5 8.5 9.5 90\r\n",
    "mark.csv": b"\xef\xbb\xbfid,x [mm],y [mm],z [mm]\n1,1.5,2.5,3.5\n2,4.5,5.5,6.5\n3,7.5,8.5,9.5\n",
    "wide.txt": "x\ty\tz\n1.5\t2.5\t3.5\n4.5\t5.5\t6.5\n7.5\t8.5\t9.5\n".encode("utf-16"),
    "comma.txt": b"1,5 2,5 3,5\n4,5 5,5 6,5\n7,5 8,5 9,5\n",
    "comma.csv": b"x;y;z\n1,5;2,5;3,5\n4,5;5,5;6,5\n7,5;8,5;9,5\n",
    "quoted.csv": b'"x";"y";"z"\n"1,5";"2,5";"3,5"\n"4,5";"5,5";"6,5"\n"7,5";"8,5";"9,5"\n',
    "spaced.csv": b"1.5, 2.5, 3.5\n4.5, 5.5, 6.5\n7.5, 8.5, 9.5\n",
    "mesh.obj": b"# J\xf6rg\nv 1.5 2.5 3.5 1 0 0\nvn 0 0 1\nv 4.5 5.5 6.5\nvt 0 1\nv 7.5 8.5 9.5\nf 1 2 3\n",
    "mesh.stl": stl_of(POINTS),
    "old_mac.obj": b"v 1.5 2.5 3.5\rvn 0 0 1\rv 4.5 5.5 6.5\rv 7.5 8.5 9.5\r",
    "capitals.stl": b"SOLID\nFACET NORMAL 0 0 1\nOUTER LOOP\nVERTEX 1.5 2.5 3.5\nVERTEX 4.5 5.5 6.5\n"
    b"VERTEX 7.5 8.5 9.5\nENDLOOP\nENDFACET\nENDSOLID\n",
    "text.stl": b"solid J\xf6rg\nfacet normal 0 0 1\nouter loop\nvertex 1.5 2.5 3.5\nvertex 4.5 5.5 6.5\n"
    b"vertex 7.5 8.5 9.5\nendloop\nendfacet\nendsolid\n",
    "fields.npy": array_file(np.array([tuple(p) for p in POINTS], [("f0", "f4"), ("f1", "f4"), ("f2", "f4")])),
    "padded.npy": array_file(
        np.array(
            [(9, *p) for p in POINTS], np.dtype([("rgb", "u1"), ("x", "f4"), ("y", "f4"), ("z", "f4")], align=True)
        )
    ),
    "organised.npy": array_file(np.array(POINTS).reshape(3, 1, 3)),
}


@pytest.mark.parametrize("name", AS_WRITTEN)
def test_files_as_other_programs_write_them_hold_the_same_points(tmp_path, name):
    (tmp_path / name).write_bytes(AS_WRITTEN[name])
    assert read_points(tmp_path / name).tolist() == POINTS


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
    "points.doc": b"1 2 3\n",
    "flat.obj": b"v 1 2\n",
    "cut.stl": bytes(80) + b"\2\0\0\0" + bytes(50),
    "two_ways.csv": b"1,5,2,5,3,5\n4,5,5,5,6,5\n",
    "thousands.txt": b"1,234.5 2.0 3.0\n",
    "points_and_commas.txt": b"1,5 2,5 3.5\n",
    "unnamed.csv": b"id,east,north\n1,2,3\n",
    "narrow.csv": b"x,y,z,red\n1,2,3\n",
    "numbered.txt": b"1 10.5 20 30\n2 11.5 20 30\n3 12.5 20 30\n",
    "miscounted.pts": b"3\n1 2 3\n4 5 6\n",
    "gap.csv": b"1.0,,2.0,3.0\n",
    "gap_of_semicolons.csv": b"1.0;;2.0;3.0\n",
    "some_labels.xyz": b"C 1.5 2.5 3.5\n4.5 5.5 6.5 1\n",
    "lists.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
    b"property float z\nproperty list uchar int rays\nend_header\n" + struct.pack("<fffBi", 1, 2, 3, 1, 0) + b"\0\0",
    "mis_sized.ply": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
    b"property float z\nend_header\n1 2 3 4\n",
    "far.pcd": pcd_head(1, "binary_compressed", "x y z", "4 4 4", "F F F", "1 1 1")
    + struct.pack("<II", 2, 12)
    + b"\x3f\xff",
    "channels_first.npy": array_file(np.zeros((3, 40, 60))),
    "depth.npy": array_file(np.zeros((480, 640))),
    "polar.npy": array_file(np.zeros(9, [("r", "f4"), ("phi", "f4"), ("z", "f4"), ("i", "u1")])),
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


def test_nans_that_signal_are_missing_points_without_a_warning(tmp_path):
    words = np.full((10, 3), 0x7F800001, dtype="<u4")
    np.save(tmp_path / "p.npy", words.view("<f4"))
    assert np.isnan(read_points(tmp_path / "p.npy")).all()
