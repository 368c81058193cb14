# SPDX-License-Identifier: GPL-3.0-or-later
"""COPC, LAZ with an octree, is read and becomes plain LAZ."""

import struct

import numpy as np
import pytest

from addon import cli, files
from core import shapes

laspy = pytest.importorskip("laspy")
lazrs = pytest.importorskip("lazrs")

COUNT = 3000


@pytest.fixture
def octree(tmp_path, monkeypatch):
    """A COPC file: the points of a sphere in two nodes of an octree."""
    from laspy._compression import lazrsbackend
    from laspy.vlrs.vlrlist import VLRList

    points, _, _ = shapes.SPHERE.sample(COUNT, seed=0)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = np.zeros(3), np.full(3, 1e-6)
    header.vlrs.append(laspy.VLR("copc", 1, "info", bytes(160)))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.intensity = np.arange(COUNT) % 1000
    las.evlrs = VLRList([laspy.VLR("copc", 1000, "hierarchy", bytes(64))])

    def begun(self, dest, point_format, parallel):
        """Begin chunks that may hold any number of points, as COPC has them."""
        assert not parallel
        self.dest, self.parallel, self.compressor = dest, parallel, None
        self.vlr = lazrs.LazVlr.new_for_compression(
            point_format.id, point_format.num_extra_bytes, True
        )

    def written(self, record):
        half = len(record) // 2 * record.array.itemsize
        data = np.frombuffer(record.array, np.uint8)
        for chunk in (data[:half], data[half:]):
            self.compressor.compress_many(chunk)
            self.compressor.finish_current_chunk()

    path = tmp_path / "a.copc.laz"
    with monkeypatch.context() as patch:
        patch.setattr(lazrsbackend.LazrsPointWriter, "__init__", begun)
        patch.setattr(lazrsbackend.LazrsPointWriter, "write_points", written)
        las.write(path, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    with laspy.open(path) as reader:
        start = reader.header.offset_to_point_data
        record = reader.header.vlrs.get("LasZipVlr")[0].record_data
    with path.open("rb") as file:
        file.seek(start)
        chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(record))
    data = bytearray(path.read_bytes())
    at = struct.unpack_from("<Q", data, 235)[0] + 60
    # Behind the place of the table of chunks.
    place = start + 8
    for level, (count, size) in enumerate(chunk for chunk in chunks if chunk[0]):
        node = (level, 0, 0, 0, place, size, count)
        struct.pack_into("<4iQ2i", data, at + 32 * level, *node)
        place += size
    info = (0.0, 0.0, 0.0, 1.0, 0.1, at, 64, 0.0, 0.0)
    struct.pack_into("<5d2Q2d", data, 375 + 54, *info)
    path.write_bytes(data)
    return path, points


@pytest.mark.parametrize("more", [[], ["--memory", "500M"]])
def test_an_octree_becomes_plain_laz(more, octree, tmp_path):
    path, points = octree
    with laspy.CopcReader.open(path) as reader:
        # What other programs take for COPC: the octree leads to all points.
        assert len(reader.query()) == COUNT
    np.testing.assert_allclose(files.read(path).points, points, atol=1e-6)
    target = tmp_path / "out" / "a.laz"
    assert cli.main(["estimate", str(path), "-o", f"{target.parent}/", *more]) == 0
    with laspy.open(target) as reader:
        found = reader.read()
        records = [*reader.header.vlrs, *(reader.header.evlrs or ())]
    assert not [record for record in records if record.user_id == "copc"]
    assert np.array_equal(found.intensity, np.arange(COUNT) % 1000)
    normals = files.read(target).normals
    assert (np.einsum("ij,ij->i", normals, points) > 0.999).all()
