# SPDX-License-Identifier: GPL-3.0-or-later
"""Files keep what they held, and get normals."""

import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from addon import files
from addon.files import FileError, ply
from addon.files.pcd import decompressed
from addon.files.shape import Polygons, Shape

# UTM: single precision is half a meter off here.
UTM = np.array([623_000.25, 4_851_000.5, 1_234.75])
WITH_NORMALS = [
    name
    for name, kind in files.FORMATS.items()
    if kind.holds_normals and not kind.needs_blender
]


@pytest.fixture
def cloud():
    """Points far out, their normals, colors and a column of whole numbers."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colors = rng.integers(0, 256, (50, 3), dtype=np.uint8)
    columns = dict(zip(("red", "green", "blue"), colors.T, strict=True))
    columns["intensity"] = rng.integers(0, 60_000, 50, dtype=np.uint16)
    points = UTM + np.round(rng.uniform(-50, 50, (50, 3)), 4)
    return Shape(points, None, normals, columns)


def again(path: Path, shape: Shape) -> Shape:
    files.write(path, shape)
    return files.read(path)


@pytest.mark.parametrize("suffix", WITH_NORMALS)
def test_points_keep_order_and_precision(suffix, tmp_path, cloud):
    found = again(tmp_path / f"cloud{suffix}", cloud)
    # LAS has whole numbers of steps: 1e-7 m for this extent.
    tolerance = 1e-7 if suffix in (".las", ".laz") else 0
    assert np.abs(found.points - cloud.points).max() <= tolerance
    assert found.points.dtype == np.float64
    # Single precision where a format has it for normals.
    assert np.abs(found.normals - cloud.normals).max() < 1e-7


@pytest.mark.parametrize("suffix", [".ply", ".csv", ".npz", ".las", ".laz", ".pcd"])
def test_colors_and_columns_come_along(suffix, tmp_path, cloud):
    found = again(tmp_path / f"cloud{suffix}", cloud)
    for name in ("red", "green", "blue"):
        values = found.columns[name]
        if suffix in (".las", ".laz"):
            values = values // 257
        assert np.array_equal(values, cloud.columns[name])
    assert np.array_equal(found.columns["intensity"], cloud.columns["intensity"])


@pytest.mark.parametrize("suffix", [".xyz", ".npy", ".pts"])
def test_what_has_no_place_is_named(suffix, tmp_path, cloud):
    lost = files.write(tmp_path / f"cloud{suffix}", cloud)
    assert set(lost) == {"red", "green", "blue", "intensity"}


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".npz", ".stl"])
def test_faces_come_along(suffix, tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]])
    faces = Polygons.of_rows([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    found = again(tmp_path / f"tent{suffix}", Shape(points, faces, points))
    assert np.array_equal(found.points[found.faces], points[faces.triangles])


def test_polygons_become_fans_and_turn():
    faces = Polygons(np.array([0, 1, 2, 3, 4, 5, 6]), np.array([4, 3]))
    assert faces.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    assert faces.face_of_triangle.tolist() == [0, 0, 1]
    turned = faces.turned(np.array([True, False]))
    assert turned.corners.tolist() == [0, 3, 2, 1, 4, 5, 6]


HEADER = """ply
format {} 1.0
comment made by hand
element vertex 4
property double x
property double y
property double z
property uchar quality
element face 2
property list uchar int vertex_indices
property float area
element camera 1
property float focal
end_header
"""


def mixed_ply(kind: str) -> bytes:
    """A PLY file with a quad, a triangle, and an element that we do not know."""
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(kind)
    points = [(0, 0, 0, 7), (1, 0, 0, 8), (1, 1, 0, 9), (0, 1, 0.1, 255)]
    faces = [((0, 1, 2, 3), 0.5), ((0, 2, 3), 0.25)]
    if order is None:
        body = "".join("{} {} {} {}\n".format(*p) for p in points)
        body += "4 0 1 2 3 0.5\n3 0 2 3 0.25\n35.5\n"
        return (HEADER.format(kind) + body).encode()
    data = b"".join(struct.pack(order + "dddB", *p) for p in points)
    for corners, area in faces:
        data += struct.pack(f"{order}B{len(corners)}if", len(corners), *corners, area)
    return HEADER.format(kind).encode() + data + struct.pack(order + "f", 35.5)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_keeps_every_element(kind, tmp_path):
    path = tmp_path / "mixed.ply"
    path.write_bytes(mixed_ply(kind))
    shape = files.read(path)
    assert shape.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 2, 3]]
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    other = Shape(shape.points, shape.polygons, normals, shape.columns, shape.kept)
    found = again(tmp_path / "again.ply", other)
    assert found.kept.format == kind
    assert found.kept.comments == ("comment made by hand",)
    vertex, face, camera = found.kept.elements
    assert [item.name for item in vertex.properties][3:] == ["quality", *ply.NORMALS]
    assert vertex.data["quality"].tolist() == [7, 8, 9, 255]
    assert face.data["area"].tolist() == [0.5, 0.25]
    assert face.data["vertex_indices"][0].tolist() == [0, 1, 2, 3, 0, 2, 3]
    assert camera.data["focal"].tolist() == [35.5]
    assert found.normals.dtype == np.float64
    # Without its normals the file is the old one, byte for byte, but for the header.
    if kind == "binary_big_endian":
        assert (tmp_path / "again.ply").read_bytes().endswith(mixed_ply(kind)[-30:])


def with_normals(path: Path, target: Path, normal=(0.0, 0.0, 1.0)) -> str:
    shape = files.read(path)
    normals = np.tile(np.array(normal), (len(shape.points), 1))
    same = Shape(
        shape.points, shape.polygons, normals, shape.columns, shape.kept, shape.suffix
    )
    assert files.write(target, same) == []
    return target.read_bytes().decode("latin-1")


def test_text_keeps_every_digit_and_comment(tmp_path):
    (tmp_path / "a.xyz").write_text("# survey\n1.10 2 3e0\n\n4.000 5 -6.50\n", "utf-8")
    text = with_normals(tmp_path / "a.xyz", tmp_path / "b.xyz")
    assert text == "# survey\n1.10 2 3e0 0 0 1\n\n4.000 5 -6.50 0 0 1\n"
    # Normals that are there are replaced.
    text = with_normals(tmp_path / "b.xyz", tmp_path / "c.xyz", (1.0, 0.0, 0.0))
    assert text == "# survey\n1.10 2 3e0 1 0 0\n\n4.000 5 -6.50 1 0 0\n"


def test_csv_keeps_columns_of_text(tmp_path):
    (tmp_path / "a.csv").write_bytes(
        b"id,X,Y,Z,class\r\nA7,1,2,3.0,tree\r\nB,4,5,6,\r\n"
    )
    text = with_normals(tmp_path / "a.csv", tmp_path / "b.csv")
    assert text == (
        "id,X,Y,Z,class,nx,ny,nz\r\nA7,1,2,3.0,tree,0,0,1\r\nB,4,5,6,,0,0,1\r\n"
    )
    assert files.read(tmp_path / "b.csv").normals.tolist() == [[0, 0, 1]] * 2


def test_pts_with_intensity_and_colors(tmp_path):
    (tmp_path / "a.pts").write_text("2\n0 0 0 -1200 10 20 30\n1 0 0 5 1 2 3\n", "utf-8")
    shape = files.read(tmp_path / "a.pts")
    assert shape.columns["intensity"].tolist() == [-1200, 5]
    assert shape.columns["blue"].tolist() == [30, 3]


def test_header_behind_a_comment_sign(tmp_path):
    (tmp_path / "a.txt").write_text(
        "//X Y Z R G B Nx Ny Nz\n1 2 3 9 8 7 0 1 0\n", "utf-8"
    )
    shape = files.read(tmp_path / "a.txt")
    assert shape.normals.tolist() == [[0, 1, 0]]
    assert shape.columns["red"].tolist() == [9]


OBJ = """mtllib m.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vn 1 0 0
g one
usemtl red
f 1/1/1 2/2/1 3/1/1
f -4/2 -2/1 -1/2
l 1 2
"""


def test_obj_changes_normals_alone(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ, "utf-8")
    text = with_normals(tmp_path / "a.obj", tmp_path / "b.obj")
    lines = text.split("\n")
    old = [line for line in OBJ.split("\n") if line[:2] not in ("vn", "f ")]
    assert [line for line in lines if line[:2] not in ("vn", "f ")] == old
    assert lines.count("vn 0 0 1") == 4
    assert "f 1/1/1 2/2/2 3/1/3" in lines
    assert "f -4/2/1 -2/1/3 -1/2/4" in lines
    assert files.read(tmp_path / "b.obj").normals.tolist() == [[0, 0, 1]] * 4


def test_a_turned_face_of_obj_takes_its_texture_along(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ, "utf-8")
    shape = files.read(tmp_path / "a.obj")
    turned = shape.polygons.turned(np.array([True, False]))
    normals = np.zeros((4, 3))
    files.write(
        tmp_path / "b.obj", Shape(shape.points, turned, normals, {}, shape.kept)
    )
    assert "\nf 1/1/1 3/1/3 2/2/2\n" in (tmp_path / "b.obj").read_text("utf-8")


def test_off_keeps_colors_of_faces(tmp_path):
    (tmp_path / "a.off").write_text(
        "OFF # tent\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 200 10 10\n", "utf-8"
    )
    text = with_normals(tmp_path / "a.off", tmp_path / "b.off")
    assert text.split("\n")[0] == "NOFF"
    assert "3 0 1 2 200 10 10" in text
    assert files.read(tmp_path / "b.off").normals.tolist() == [[0, 0, 1]] * 3


def test_stl_joins_corners_and_reads_text(tmp_path):
    facet = "facet normal 0 0 1\nouter loop\n{}endloop\nendfacet\n"
    corners = [["0 0 0", "1 0 0", "1 1 0"], ["0 0 -0.0", "1 1 0", "0 1e0 0"]]
    body = "".join(
        facet.format("".join(f"vertex {c}\n" for c in three)) for three in corners
    )
    (tmp_path / "a.stl").write_text(f"solid a\n{body}endsolid a\n", "utf-8")
    shape = files.read(tmp_path / "a.stl")
    assert shape.points.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert shape.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_npy_keeps_its_columns(tmp_path):
    rng = np.random.default_rng(1)
    array = rng.uniform(size=(20, 5)).astype(np.float32)
    np.save(tmp_path / "a.npy", array)
    with_normals(tmp_path / "a.npy", tmp_path / "b.npy")
    found = np.load(tmp_path / "b.npy")
    assert found.dtype == np.float32
    assert np.array_equal(found[:, :5], array)
    assert files.read(tmp_path / "b.npy").normals.tolist() == [[0, 0, 1]] * 20
    with_normals(tmp_path / "b.npy", tmp_path / "c.npy", (0.0, 1.0, 0.0))
    assert np.load(tmp_path / "c.npy").shape == (20, 8)


def test_npy_of_named_fields(tmp_path):
    rows = np.zeros(5, [("x", "f8"), ("y", "f8"), ("z", "f8"), ("label", "i4")])
    rows["label"] = np.arange(5)
    np.save(tmp_path / "a.npy", rows)
    with_normals(tmp_path / "a.npy", tmp_path / "b.npy")
    found = np.load(tmp_path / "b.npy")
    assert found.dtype.names == ("x", "y", "z", "label", "nx", "ny", "nz")
    assert np.array_equal(found["label"], rows["label"])


def test_npz_keeps_its_arrays_and_its_bytes(tmp_path):
    np.savez(tmp_path / "a.npz", points=np.eye(3), labels=np.arange(7), name="ok")
    with_normals(tmp_path / "a.npz", tmp_path / "b.npz")
    with_normals(tmp_path / "a.npz", tmp_path / "c.npz")
    with np.load(tmp_path / "b.npz") as found:
        assert set(found) == {"points", "labels", "name", "normals"}
        assert found["labels"].tolist() == list(range(7))
    # No date in it: the same input makes the same file.
    assert (tmp_path / "b.npz").read_bytes() == (tmp_path / "c.npz").read_bytes()


PCD = """# .PCD v0.7
VERSION 0.7
FIELDS x y z rgb _ label
SIZE 4 4 4 4 1 2
TYPE F F F F U I
COUNT 1 1 1 1 4 1
WIDTH 3
HEIGHT 2
VIEWPOINT 0 0 5 1 0 0 0
POINTS 6
DATA {}
"""


def test_pcd_keeps_fields_padding_and_organization(tmp_path):
    kinds = [("xyz", "<f4", 3), ("rgb", "<u4"), ("pad", "u1", 4), ("label", "<i2")]
    rows = np.zeros(6, kinds)
    rows["xyz"] = np.random.default_rng(0).uniform(size=(6, 3))
    rows["xyz"][4] = np.nan
    rows["rgb"], rows["label"] = 0x0A141E, np.arange(-3, 3)
    (tmp_path / "a.pcd").write_bytes(PCD.format("binary").encode() + rows.tobytes())
    shape = files.read(tmp_path / "a.pcd")
    assert [shape.columns[name][0] for name in ("red", "green", "blue")] == [10, 20, 30]
    text = with_normals(tmp_path / "a.pcd", tmp_path / "b.pcd")
    for line in (
        "WIDTH 3",
        "HEIGHT 2",
        "VIEWPOINT 0 0 5 1 0 0 0",
        "COUNT 1 1 1 1 4 1 1",
    ):
        assert f"\n{line}" in text
    found = files.read(tmp_path / "b.pcd")
    assert np.array_equal(found.points, shape.points, equal_nan=True)
    assert found.columns["label"].tolist() == list(range(-3, 3))
    assert found.normals.tolist() == [[0, 0, 1]] * 6


def test_pcd_as_text(tmp_path):
    body = "0.1 0 0 4.2e6 1 2 3 4 7\n" * 6
    (tmp_path / "a.pcd").write_text(PCD.format("ascii") + body, "utf-8")
    text = with_normals(tmp_path / "a.pcd", tmp_path / "b.pcd")
    assert text.endswith("0.1 0.0 0.0 4.2e+06 1 2 3 4 7 0.0 0.0 1.0\n")


def test_lzf_references_may_overlap_what_they_make():
    # One literal "ab", then six bytes from two back: "abababab".
    assert decompressed(b"\x01ab" + bytes([4 << 5, 1]), 8) == b"abababab"
    with pytest.raises(FileError, match="damaged"):
        decompressed(bytes([4 << 5, 9]), 6)


def test_las_keeps_dimensions_and_records(tmp_path):
    import laspy

    header = laspy.LasHeader(point_format=3, version="1.2")
    header.offsets, header.scales = UTM, [0.01] * 3
    header.vlrs.append(laspy.VLR("someone", 7, "note", b"kept"))
    las = laspy.LasData(header)
    rng = np.random.default_rng(0)
    las.X, las.Y, las.Z = rng.integers(-5000, 5000, (3, 40))
    las.gps_time = rng.uniform(size=40)
    las.classification = rng.integers(0, 20, 40)
    las.write(tmp_path / "a.las")
    with_normals(tmp_path / "a.las", tmp_path / "b.las")
    found = laspy.read(tmp_path / "b.las")
    for name in ("X", "Y", "Z", "gps_time", "classification"):
        assert np.array_equal(found[name], las[name])
    assert found.header.vlrs.get_by_id("someone")[0].record_data == b"kept"
    assert found.header.scales.tolist() == [0.01] * 3
    assert np.asarray(found["NormalZ"]).tolist() == [1] * 40


def test_a_missing_library_is_named_with_its_cure(tmp_path, monkeypatch, cloud):
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(FileError, match=r'laspy.*-m pip install "laspy\[lazrs\]"'):
        files.write(tmp_path / "a.las", cloud)


LIES = {
    "vertices.ply": b"ply\nformat binary_little_endian 1.0\n"
    b"element vertex 999999999999\nproperty float x\nproperty float y\n"
    b"property float z\nend_header\n" + b"0" * 60,
    "corners.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 1\n"
    b"property float x\nproperty float y\nproperty float z\nelement face 1\n"
    b"property list uint int vertex_indices\nend_header\n" + b"\xff" * 24,
    "text.ply": b"ply\nformat ascii 1.0\nelement vertex 99999999999\n"
    b"property float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
    "facets.stl": b"\0" * 80 + b"\xff\xff\xff\xff" + b"\0" * 50,
    "counts.off": b"OFF\n99999999999999999999 1 0\n0 0 0\n",
    "points.pcd": PCD.format("binary").replace("3", "99999999").encode(),
    "packed.pcd": b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 300000000\nHEIGHT 1\n"
    b"DATA binary_compressed\n" + struct.pack("<II", 8, 3_600_000_000) + b"\0" * 8,
    "shape.npy": b"\x93NUMPY\x01\0\x76\0"
    + b"{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999, 3), }".ljust(
        117
    )
    + b"\n",
    "objects.npy": b"\x93NUMPY\x01\0\x76\0"
    + b"{'descr': '|O', 'fortran_order': False, 'shape': (1, 3), }".ljust(117)
    + b"\n0",
    "count.pts": b"5000000000\n0 0 0\n",
    "face.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999\n",
    "short.las": b"LASF" + b"\0" * 20 + b"\x01\x02" + b"\0" * 300,
}


@pytest.mark.parametrize("name", LIES)
def test_a_header_that_lies_is_a_sentence(name, tmp_path):
    (tmp_path / name).write_bytes(LIES[name])
    with pytest.raises(FileError, match=r"expected|needs"):
        files.read(tmp_path / name)
