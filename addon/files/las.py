# SPDX-License-Identifier: GPL-3.0-or-later
"""LAS and LAZ by laspy: every dimension kept, normals as dimensions of their own."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from . import laz
from .libraries import needed
from .shape import COLORS, FileError, Shape, checked_count

NORMALS = ("NormalX", "NormalY", "NormalZ")
# Bytes of points that are read at a time.
CHUNK = 32 << 20

_HEADERS = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375, 5: 393}
_SCALES = (96, 56)  # Where the header holds scales, and where its count begins.


def read(path: Path) -> Shape:
    """Read points in double precision and all dimensions."""
    with opened(path) as reader:
        parts = [part.array for part in reader.chunk_iterator(chunk_of(reader.header))]
        header = reader.header
        array = np.concatenate(parts or [np.empty(0, header.point_format.dtype())])
        if len(array) != header.point_count:
            raise FileError(
                f"expected {header.point_count:,} points, which its header announces, "
                f"got {len(array):,}"
            )
        return _shape(array, header)


def _shape(array, header):
    laspy = needed("laspy", "LAS files")
    record = laspy.ScaleAwarePointRecord(
        array, header.point_format, header.scales, header.offsets
    )
    las = laspy.LasData(header, record)
    columns = {}
    for name in header.point_format.dimension_names:
        values = np.asarray(las[name])
        if name not in ("X", "Y", "Z") and values.ndim == 1:
            columns[name] = values
    normals = None
    if set(NORMALS) <= set(columns):
        normals = np.stack([columns.pop(name) for name in NORMALS], axis=1)
        normals = normals.astype(np.float64)
    return Shape(xyz(record), None, normals, columns, las)


def xyz(record: Any) -> Any:
    """Return coordinates, (n, 3) float64."""
    return np.ascontiguousarray(
        np.stack([record.x, record.y, record.z], axis=1), dtype=np.float64
    )


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a file whose header has been checked; every way to fail is a FileError."""
    laspy = needed("laspy", "LAS files")
    with path.open("rb") as file:
        compressed = check_header(file, path.stat().st_size)
    if compressed:
        needed("lazrs", "compressed LAS files")
    try:
        # The parallel decoder believes the sizes that a table of chunks announces.
        backend = laspy.LazBackend.Lazrs if compressed else None
        with laspy.open(path, read_evlrs=False, laz_backend=backend) as reader:
            if compressed:
                _check_compressed(path, reader.header)
            yield reader
    except FileError:
        raise
    except (*_failures(laspy, compressed),) as error:
        raise _damaged(error) from None
    except BaseException as error:
        # What a decoder in Rust could not foresee is no Exception.
        if type(error).__name__ != "PanicException":
            raise
        raise _damaged(error) from None


def _damaged(error):
    said = str(error).partition("\n")[0][:100] or type(error).__name__
    return FileError(f"expected a LAS file, got a damaged one: {said}")


def _failures(laspy, compressed):
    """Return what laspy and its decoder raise about damaged files."""
    common: tuple[Any, ...] = (
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        AttributeError,
        struct.error,
    )
    common += (ArithmeticError, EOFError, AssertionError, laspy.errors.LaspyException)
    return (*common, needed("lazrs", "").LazrsError) if compressed else common


def check_header(file: BinaryIO, size: int) -> bool:
    """Check the counts of a header against the size of the file.

    Returns
    -------
    bool
        Whether the points are compressed.
    """
    head = file.read(max(_HEADERS.values()))
    if head[:4] != b"LASF" or len(head) < _HEADERS[0]:
        raise FileError("expected a LAS file, which begins with LASF")
    minor = head[25]
    if head[24] != 1 or minor not in _HEADERS or len(head) < _HEADERS[minor]:
        raise FileError(f"expected LAS 1.0 to 1.5, got {head[24]}.{minor}")
    header, data, records, kind, each, count = struct.unpack_from("<HIIBHI", head, 94)
    if minor >= 4:
        start, extended, count = struct.unpack_from("<QIQ", head, 235)
        checked_count(extended, 60, size - start if start else size, "records")
    if not _HEADERS[minor] <= header <= data <= size:
        raise FileError("expected a header that ends before the points begin")
    checked_count(records, 54, data - header, "records")
    if not all(np.isfinite(struct.unpack_from("<6d", head, 131))):
        raise FileError("expected scales and offsets that are finite")
    compressed = bool(kind & 0xC0)
    if not compressed:
        checked_count(count, each, size - data, "points")
    return compressed


def _check_compressed(path, header):
    found = header.vlrs.get("LasZipVlr")
    if not found:
        raise FileError("expected a record about the compression, got none")
    with path.open("rb") as file:
        laz.check(
            file,
            path.stat().st_size,
            found[0].record_data,
            header.offset_to_point_data,
            header.point_format.size,
        )


def chunk_of(header: Any) -> int:
    """Return how many points are read at a time."""
    return max(1, CHUNK // header.point_format.size)


def write(path: Path, shape: Shape) -> None:
    """Write points with normals, compressed where the name ends with .laz."""
    laspy = needed("laspy", "LAS files")
    compressed = path.suffix.lower() == ".laz"
    if compressed:
        needed("lazrs", "compressed LAS files")
    las = shape.kept if isinstance(shape.kept, laspy.LasData) else _new(shape)
    las = with_normals(las)
    for name, values in zip(NORMALS, shape.normals.T, strict=True):
        las[name] = values.astype("f4")
    with path.open("wb") as file:
        las.write(file, do_compress=compressed)


def with_normals(las: Any) -> Any:
    """Return points that have dimensions for normals, without the index of COPC."""
    laspy = needed("laspy", "LAS files")
    known = set(las.point_format.dimension_names)
    added = [
        laspy.ExtraBytesParams(name=name, type="f4", description="normal")
        for name in NORMALS
        if name not in known
    ]
    # A copy, so that the shape it came from stays as it is.
    las = laspy.LasData(las.header, las.points.copy())
    if added:
        las.add_extra_dims(added)
    drop_index(las.header)
    return las


def with_dimensions(header: Any) -> Any:
    """Return a header that has dimensions for normals, without the index of COPC."""
    laspy = needed("laspy", "LAS files")
    header = deepcopy(header)
    known = set(header.point_format.dimension_names)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(name=name, type="f4", description="normal")
            for name in NORMALS
            if name not in known
        ]
    )
    drop_index(header)
    return header


def drop_index(header: Any) -> None:
    """Forget the index of a COPC file: the points are in no octree any more."""
    header.vlrs = [item for item in header.vlrs if item.user_id != "copc"]
    header.evlrs = [item for item in header.evlrs or () if item.user_id != "copc"]


def _new(shape):
    """Return the points of a shape from another format, as exact as LAS has them."""
    laspy = needed("laspy", "LAS files")
    header = laspy.LasHeader(point_format=7, version="1.4")
    low, high = shape.points.min(axis=0), shape.points.max(axis=0)
    if not np.isfinite([low, high]).all():
        raise FileError("LAS holds finite coordinates alone: choose .ply or .pcd")
    header.offsets = np.floor(low)
    span = np.maximum(high - header.offsets, 1e-9)
    # The least power of ten that leaves the coordinates in 31 bits.
    header.scales = 10.0 ** np.ceil(np.log10(span / (2**31 - 2)))
    las = laspy.LasData(header)
    las.x, las.y, las.z = shape.points.T.astype(np.float64)
    standard = set(header.point_format.dimension_names)
    extra = {name: v for name, v in shape.columns.items() if name not in standard}
    las.add_extra_dims(
        [
            laspy.ExtraBytesParams(name=n[:32], type=v.dtype.str[1:])
            for n, v in extra.items()
        ]
    )
    for name, values in shape.columns.items():
        las[name[:32]] = _as_words(values) if name in COLORS else values
    return las


def _as_words(colors):
    """Return colors as LAS has them, 0 to 65535."""
    words = np.asarray(colors).astype("u2")
    return words * 257 if colors.dtype.itemsize == 1 else words
