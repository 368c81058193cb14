# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of points that are read and written piece by piece, whatever their size."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from . import arrays, las, ply, ply_header
from .libraries import needed
from .shape import NORMALS, FileError, checked_count

# Points at a time.
ROWS = 500_000


_REMEDY = "convert it first, or leave out --memory and --scheduler"


class Stream(Protocol):
    """Points in the order of a file.

    Attributes
    ----------
    count : int
    dtype : numpy.dtype
        Of the normals that the file can hold.
    """

    count: int
    dtype: np.dtype

    def chunks(self) -> Iterator[Any]:
        """Yield the points piece by piece, (m, 3) float64."""
        ...

    def write(self, path: Path, normals: Iterator[Any]) -> None:
        """Write the file again with normals that come in pieces of their own."""
        ...


def open_stream(path: Path) -> Stream:
    """Return the stream of a file.

    Raises
    ------
    FileError
        When its format has none, or it is damaged.
    """
    found = _STREAMS.get(path.suffix.lower())
    if found is None:
        raise FileError(
            f"expected a file of {', '.join(_STREAMS)} for work in tiles, "
            f"got {path.suffix}: {_REMEDY}"
        )
    try:
        return found(path)
    except OSError as error:
        raise FileError(f"cannot be read: {error.strerror or error}") from None


class _Rebatched:
    """An iterator of arrays as one that gives as many rows as are asked for."""

    def __init__(self, parts: Iterator[Any]) -> None:
        self.parts = parts
        self.rest: Any = np.empty((0, 3))

    def take(self, count: int) -> Any:
        """Return the next (count, 3) rows."""
        found = [self.rest]
        have = len(self.rest)
        while have < count:
            found.append(next(self.parts))
            have += len(found[-1])
        rows = np.concatenate(found)
        self.rest = rows[count:]
        return rows[:count]


class _Records:
    """Rows of one length in a file, without anything between them."""

    def __init__(self, path: Path, at: int, count: int, dtype: np.dtype) -> None:
        self.path, self.at, self.count, self.record = path, at, count, dtype
        left = path.stat().st_size - at
        checked_count(count, dtype.itemsize, left, "points")

    def records(self) -> Iterator[Any]:
        """Yield the rows piece by piece."""
        with self.path.open("rb") as file:
            file.seek(self.at)
            for start in range(0, self.count, ROWS):
                count = min(ROWS, self.count - start)
                # Not by a map: what is read would count as ours for long.
                yield np.fromfile(file, self.record, count)


class PlyStream(_Records):
    """Vertices of a binary PLY file; what stands behind them is copied."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self.header = ply_header.read_header(file)
        if self.header.format == "ascii":
            raise FileError(
                f"expected a binary PLY file for work in tiles, got text: {_REMEDY}"
            )
        self.vertex = ply.vertex_element(self.header)
        before = self.header.elements[: self.header.elements.index(self.vertex)]
        if any(element.has_lists for element in before):
            raise FileError("expected the vertices before elements with lists")
        order = self.header.order
        sizes = [element.count * element.dtype(order).itemsize for element in before]
        self.before = sum(sizes)
        at = self.header.size + self.before
        super().__init__(path, at, self.vertex.count, self.vertex.dtype(order))
        kinds = {item.name: item for item in ply.with_normals(self.vertex).properties}
        self.dtype = np.dtype(kinds["nx"].type)

    def chunks(self) -> Iterator[Any]:
        """Yield points."""
        for rows in self.records():
            yield np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1)

    def write(self, path: Path, normals: Iterator[Any]) -> None:
        """Write every element, the vertices with normals."""
        element = ply.with_normals(self.vertex)
        elements = tuple(
            element if e is self.vertex else e for e in self.header.elements
        )
        header = replace(self.header, elements=elements)
        wider, given = element.dtype(header.order), _Rebatched(normals)
        with path.open("wb") as out, self.path.open("rb") as file:
            out.write(ply_header.header_text(header))
            file.seek(self.header.size)
            _copy(file, out, self.before)
            for rows in self.records():
                out.write(_with_fields(rows, wider, given.take(len(rows))).tobytes())
            file.seek(self.at + self.count * self.record.itemsize)
            _copy(file, out, None)


def _with_fields(rows, wider, normals):
    made = np.empty(len(rows), wider)
    for name in rows.dtype.names:
        made[name] = rows[name]
    for name, values in zip(NORMALS, normals.T, strict=True):
        made[name] = values
    return made


def _copy(file, out, count):
    while count is None or count > 0:
        data = file.read(1 << 20 if count is None else min(count, 1 << 20))
        if not data:
            return
        out.write(data)
        count = None if count is None else count - len(data)


class NpyStream(_Records):
    """Rows of an NPY file: (n, c) numbers, or named fields."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            shape, by_column, dtype = arrays.read_header(file, path.stat().st_size)
            at = file.tell()
        if by_column and len(shape) > 1:
            raise FileError(
                "expected an array row by row for work in tiles, got one column by "
                f"column: {_REMEDY}"
            )
        self.named = dtype.names is not None
        if not self.named:
            if len(shape) != 2 or shape[1] < 3 or dtype.kind != "f":
                raise FileError(f"expected an array (n, 3) of floats, got {shape}")
            dtype = np.dtype((dtype, (shape[1],)))
        elif len(shape) != 1 or not {"x", "y", "z"} <= set(dtype.names or ()):
            raise FileError("expected fields x, y and z")
        super().__init__(path, at, shape[0], dtype)
        head = next(self.records(), np.empty((0, 3)))
        self.first = None if self.named else arrays.normal_column(head)
        self.dtype = np.dtype("f4") if self.named else dtype.base.newbyteorder("=")

    def chunks(self) -> Iterator[Any]:
        """Yield points."""
        for rows in self.records():
            if self.named:
                yield np.stack([rows[axis].astype("f8") for axis in "xyz"], axis=1)
            else:
                yield np.ascontiguousarray(rows[:, :3], dtype=np.float64)

    def write(self, path: Path, normals: Iterator[Any]) -> None:
        """Write the rows with normals where they were, or behind the rest."""
        given = _Rebatched(normals)
        with path.open("wb") as out:
            for number, rows in enumerate(self.records()):
                made = self._made(rows, given.take(len(rows)))
                if number == 0:
                    self._write_header(out, made)
                out.write(made.tobytes())

    def _made(self, rows, normals):
        if self.named:
            added = [(n, "<f4") for n in NORMALS if n not in rows.dtype.names]
            wider = np.dtype(rows.dtype.descr + added)
            return _with_fields(rows, wider, normals)
        if self.first is None:
            return np.concatenate([rows, normals.astype(rows.dtype)], axis=1)
        rows[:, self.first : self.first + 3] = normals
        return rows

    def _write_header(self, out, made):
        shape = (self.count, *made.shape[1:])
        descr = np.lib.format.dtype_to_descr(made.dtype)
        header = {"descr": descr, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(out, header)


class LasStream:
    """Points of a LAS or LAZ file, of COPC too."""

    dtype = np.dtype("f4")

    def __init__(self, path: Path) -> None:
        self.path = path
        with las.opened(path) as reader:
            self.count = int(reader.header.point_count)

    def _records(self) -> Iterator[Any]:
        seen = 0
        with las.opened(self.path) as reader:
            for part in reader.chunk_iterator(las.chunk_of(reader.header)):
                seen += len(part)
                yield part
        if seen != self.count:
            raise FileError(f"expected {self.count:,} points, got {seen:,}")

    def chunks(self) -> Iterator[Any]:
        """Yield points."""
        for part in self._records():
            yield las.xyz(part)

    def write(self, path: Path, normals: Iterator[Any]) -> None:
        """Write every dimension and normals."""
        laspy = needed("laspy", "LAS files")
        given = _Rebatched(normals)
        with las.opened(self.path) as reader:
            reader.read_evlrs()
            header = las.with_dimensions(reader.header)
        compressed = path.suffix.lower() == ".laz"
        with path.open("wb") as file:
            writer = laspy.open(
                file, mode="w", header=header, do_compress=compressed, closefd=False
            )
            for part in self._records():
                made = laspy.ScaleAwarePointRecord.zeros(len(part), header=header)
                for name in part.array.dtype.names:
                    made.array[name] = part.array[name]
                rows = given.take(len(part))
                for name, values in zip(las.NORMALS, rows.T, strict=True):
                    made[name] = values.astype("f4")
                writer.write_points(made)
            if header.evlrs:
                writer.write_evlrs(header.evlrs)
            writer.close()


_STREAMS: dict[str, Any] = {
    ".ply": PlyStream,
    ".npy": NpyStream,
    ".las": LasStream,
    ".laz": LasStream,
}
