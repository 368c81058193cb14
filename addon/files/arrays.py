# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays of numpy: NPY with a row for each point, NPZ with an array for each thing."""

import io
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO

import numpy as np

from .shape import (
    COLORS,
    NORMALS,
    FileError,
    Polygons,
    Shape,
    checked,
    checked_count,
    looks_unit,
)

# Deflate makes nothing smaller than by this factor.
_DENSEST = 1100
_POINTS = ("points", "vertices", "xyz", "pos", "positions", "arr_0")
_FACES = ("faces", "triangles")

# A header is a literal of Python, which numpy parses.
_BAD_HEADER: tuple[Any, ...] = (ValueError, TypeError, SyntaxError, TokenError)
_BAD_HEADER += (MemoryError, RecursionError)


@dataclass(frozen=True)
class Rows:
    """The array of an NPY file, and the first of the columns that are normals."""

    array: Any
    normals: int | None


@dataclass(frozen=True)
class Members:
    """The arrays of an NPZ file, and what the points are called."""

    arrays: Mapping[str, Any]
    points: str


def read_header(file: BinaryIO, size: int) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Return shape, order and type of an array whose file has `size` bytes."""
    try:
        version = np.lib.format.read_magic(file)
        find = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(version)
        if find is None:
            raise ValueError("a version that is not known")
        shape, by_column, dtype = find(file)
    except (*_BAD_HEADER,) as error:
        raise FileError(f"expected an array of numpy, got {_first(error)}") from None
    if dtype.hasobject or any(side < 0 for side in shape):
        raise FileError(f"expected an array of numbers, got one of {dtype}")
    count = 1
    for side in shape:
        count *= side
    checked_count(count, dtype.itemsize, size - file.tell(), "numbers")
    return shape, by_column, dtype


def _first(error):
    return str(error).partition("\n")[0][:100] or type(error).__name__


def _array(file, size):
    shape, by_column, dtype = read_header(file, size)
    count = int(np.prod(shape, dtype=object))
    data = file.read(count * dtype.itemsize)
    if len(data) < count * dtype.itemsize:
        raise FileError("expected all numbers of an array, got a file that ends before")
    values = np.frombuffer(data, dtype, count)
    return values.reshape(shape, order="F" if by_column else "C")


def read_npy(path: Path) -> Shape:
    """Read (n, 3) points or (n, c) with more for each point."""
    with path.open("rb") as file:
        array = _array(file, path.stat().st_size)
    return shape_of_rows(array)


def shape_of_rows(array: Any) -> Shape:
    """Return the Shape of rows: an (n, c) array, or one of named fields."""
    if array.dtype.names:
        return _shape_of_fields(array)
    if array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "fiu":
        raise FileError(
            f"expected an array (n, 3) of numbers, got {array.shape} of {array.dtype}"
        )
    points, first = _as_floats(array[:, :3]), normal_column(array)
    normals = None if first is None else _as_floats(array[:, first : first + 3])
    taken = set() if first is None else {first, first + 1, first + 2}
    rest = {
        f"column_{at + 1}": _native(array[:, at])
        for at in range(3, array.shape[1])
        if at not in taken
    }
    return Shape(points, None, normals, rest, Rows(array, first))


def normal_column(array: Any) -> int | None:
    """Return the first of three columns that are normals: the next or the last."""
    width = array.shape[1]
    for first in (3, width - 3):
        if 3 <= first <= width - 3 and looks_unit(array[:, first : first + 3]):
            return first
    return None


def _shape_of_fields(array):
    names = array.dtype.names
    if array.ndim != 1 or not {"x", "y", "z"} <= set(names):
        raise FileError("expected fields x, y and z, got " + ", ".join(names)[:60])
    columns = {
        name: _native(array[name])
        for name in names
        if array.dtype[name].kind in "fiub" and not array.dtype[name].shape
    }
    if not {"x", "y", "z"} <= set(columns):
        raise FileError("expected numbers as fields x, y and z")
    points = _as_floats(np.stack([columns.pop(name) for name in "xyz"], axis=1))
    normals = None
    if set(NORMALS) <= set(columns):
        normals = _as_floats(np.stack([columns.pop(n) for n in NORMALS], axis=1))
    return Shape(points, None, normals, columns, Rows(array, None))


def _native(values):
    return np.ascontiguousarray(values, values.dtype.newbyteorder("="))


def _as_floats(values):
    """Return numbers as they are when single or double, else as double."""
    kind = values.dtype
    wide = (
        kind.newbyteorder("=")
        if kind.kind + str(kind.itemsize) in ("f4", "f8")
        else np.float64
    )
    return np.ascontiguousarray(values, wide)


def write_npy(path: Path, shape: Shape) -> None:
    """Write (n, 6) points and normals, or the array of before with normals in it."""
    kept = shape.kept
    if not isinstance(kept, Rows):
        array = np.concatenate([shape.points, shape.normals], axis=1)
        array = array.astype(shape.points.dtype)
    elif kept.array.dtype.names:
        array = _with_fields(kept.array, shape.normals)
    else:
        array = _with_columns(kept, shape.normals)
    with path.open("wb") as file:
        np.save(file, array, allow_pickle=False)


def _with_fields(array, normals):
    added = [(name, "f4") for name in NORMALS if name not in array.dtype.names]
    wider = np.empty(len(array), array.dtype.descr + added)
    for name in array.dtype.names:
        wider[name] = array[name]
    for name, values in zip(NORMALS, normals.T, strict=True):
        wider[name] = values
    return wider


def _with_columns(kept, normals):
    array = kept.array
    if array.dtype.kind != "f":
        array = array.astype(np.float64)
    if kept.normals is None:
        return np.concatenate([array, normals.astype(array.dtype)], axis=1)
    array = array.copy()
    array[:, kept.normals : kept.normals + 3] = normals
    return array


def read_npz(path: Path) -> Shape:
    """Read points, and normals, faces and whatever else stands beside them."""
    arrays = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for item in archive.infolist():
                checked_count(
                    item.file_size,
                    1,
                    _DENSEST * (path.stat().st_size + 1),
                    "bytes in " + item.filename[:40],
                )
                if item.filename.endswith(".npy"):
                    data = archive.read(item)
                    name = item.filename.removesuffix(".npy")
                    arrays[name] = _array(io.BytesIO(data), len(data))
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError) as error:
        raise FileError(f"expected an archive of arrays, got {_first(error)}") from None
    except zlib.error as error:
        raise FileError(f"expected an archive of arrays, got {_first(error)}") from None
    return _shape_of_members(arrays)


def _shape_of_members(arrays):
    name = next((name for name in _POINTS if name in arrays), None)
    if name is None:
        raise FileError(
            "expected an array points, got " + (", ".join(arrays)[:60] or "none")
        )
    points = arrays[name]
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise FileError(f"expected points (n, 3), got {points.shape} of {points.dtype}")
    normals = arrays.get("normals")
    if normals is not None:
        if normals.shape != points.shape or normals.dtype.kind not in "fiu":
            raise FileError(f"expected normals {points.shape}, got {normals.shape}")
        normals = _as_floats(normals)
    faces = next((arrays[name] for name in _FACES if name in arrays), None)
    if faces is not None and (faces.ndim != 2 or faces.dtype.kind not in "iu"):
        raise FileError(f"expected faces (m, 3) of whole numbers, got {faces.shape}")
    polygons = None if faces is None else Polygons.of_rows(faces)
    columns = _columns(arrays, len(points), {name, "normals", *_FACES})
    return checked(
        Shape(_as_floats(points), polygons, normals, columns, Members(arrays, name))
    )


def _columns(arrays, count, taken):
    columns = {}
    for name, values in arrays.items():
        if (
            name in taken
            or values.shape[:1] != (count,)
            or values.dtype.kind not in "fiub"
        ):
            continue
        if values.ndim == 1:
            columns[name] = _native(values)
        elif values.ndim == 2 and values.shape[1] == 3 and name in ("colors", "rgb"):
            columns |= dict(zip(COLORS, _native(values.T), strict=True))
    return columns


def write_npz(path: Path, shape: Shape) -> None:
    """Write points, normals and the rest, with the arrays of before where there are."""
    if isinstance(shape.kept, Members):
        arrays = dict(shape.kept.arrays)
    else:
        arrays = {"points": shape.points, **shape.columns}
    arrays["normals"] = shape.normals.astype(shape.points.dtype)
    if shape.polygons is not None and "triangles" not in arrays:
        arrays["faces"] = _rows_of(shape.polygons)
    with path.open("wb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as z:
        for name, values in arrays.items():
            # With a date of its own a file would differ from run to run.
            item = zipfile.ZipInfo(name + ".npy", (1980, 1, 1, 0, 0, 0))
            item.compress_type = zipfile.ZIP_DEFLATED
            with z.open(item, "w", force_zip64=True) as member:
                np.lib.format.write_array(
                    member, np.asarray(values), allow_pickle=False
                )


def _rows_of(polygons):
    alike = len(polygons.sizes) and (polygons.sizes == polygons.sizes[0]).all()
    return (
        polygons.corners.reshape(len(polygons.sizes), -1)
        if alike
        else polygons.triangles
    )
