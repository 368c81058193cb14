# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of PLY elements to arrays and back: text, and bytes in both orders."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from .ply_header import Element, Header
from .shape import FileError, checked_count


def elements_of(header: Header, body: bytes) -> Iterator[Element]:
    """Yield the elements with their data, of all that follows the header."""
    find = _text_elements if header.format == "ascii" else _binary_elements
    return find(header, body)


def _binary_elements(header: Header, body: bytes) -> Iterator[Element]:
    at = 0
    for element in header.elements:
        each = sum(item.least for item in element.properties)
        checked_count(element.count, each, len(body) - at, f"rows of {element.name}")
        if element.has_lists:
            data, at = _rows_with_lists(element, header.order, body, at)
        else:
            dtype = element.dtype(header.order)
            rows = np.frombuffer(body, dtype, element.count if each else 0, at)
            data = {name: rows[name] for name in dtype.names or ()}
            at += rows.nbytes
        yield replace(element, data=data)


def _rows_with_lists(element, order, body, at):
    """Return the data of an element with lists, and where the next one begins."""
    starts, sizes = _row_places(element, order, body, at)
    data = {}
    octets = np.frombuffer(body, "u1")
    offset = starts
    for item in element.properties:
        kind = np.dtype(order + item.type)
        if item.count is None:
            data[item.name] = _gathered(octets, offset, kind)
            offset = offset + kind.itemsize
            continue
        size = sizes[item.name]
        first = np.repeat(offset + np.dtype(item.count).itemsize, size)
        nth = np.arange(len(first)) - np.repeat(np.cumsum(size) - size, size)
        data[item.name] = _gathered(octets, first + nth * kind.itemsize, kind), size
        offset = offset + np.dtype(item.count).itemsize + size * kind.itemsize
    return data, int(offset[-1]) if len(offset) else at


def _gathered(octets, places, kind):
    """Return the numbers that begin at some places of the bytes."""
    if not len(places):
        return np.empty(0, kind)
    return octets[places[:, None] + np.arange(kind.itemsize)].view(kind)[:, 0]


def _row_places(element, order, body, at):
    """Return where each row begins, (m,), and the lengths of its lists by name."""
    names = [item.name for item in element.properties if item.count]
    if not element.count:
        return np.empty(0, np.int64), dict.fromkeys(names, np.empty(0, np.int64))
    found = _alike(element, order, body, at) or _one_by_one(element, order, body, at)
    starts, sizes = found
    return starts, dict(zip(names, sizes, strict=True))


def _alike(element, order, body, at):
    """Return the places of rows whose lists are as long as those of the first."""
    fields: list[Any] = []
    first = _one_by_one(replace(element, count=1), order, body, at)[1]
    lengths = iter(first)
    for number, item in enumerate(element.properties):
        if item.count:
            fields.append((f"count {number}", order + item.count))
            fields.append((f"list {number}", order + item.type, int(next(lengths)[0])))
        else:
            fields.append((item.name, order + item.type))
    dtype = np.dtype(fields)
    if element.count * dtype.itemsize > len(body) - at:
        return None
    rows = np.frombuffer(body, dtype, element.count, at)
    counts = [rows[name] for name in dtype.names or () if name.startswith("count ")]
    if any((count != count[0]).any() for count in counts):
        return None
    starts = at + dtype.itemsize * np.arange(element.count, dtype=np.int64)
    return starts, [count.astype(np.int64) for count in counts]


def _one_by_one(element, order, body, at):
    """Return the places of rows of any lengths, by a walk from row to row."""
    kinds = [
        (item.count and np.dtype(order + item.count), np.dtype(item.type).itemsize)
        for item in element.properties
    ]
    byteorder: Any = "big" if order == ">" else "little"
    starts: list[int] = []
    sizes: list[list[int]] = [[] for count, _ in kinds if count]
    for _ in range(element.count):
        starts.append(at)
        lists = iter(sizes)
        for count, each in kinds:
            if not count:
                at += each
                continue
            end = at + count.itemsize
            size = int.from_bytes(body[at:end], byteorder, signed=count.kind == "i")
            next(lists).append(checked_count(size, each, len(body) - end, "corners"))
            at = end + size * each
        if at > len(body):
            checked_count(element.count, at, len(body), f"rows of {element.name}")
    return np.array(starts), [np.array(size, dtype=np.int64) for size in sizes]


def _text_elements(header: Header, body: bytes) -> Iterator[Element]:
    lines = [line for line in body.decode("latin-1").split("\n") if line.strip()]
    at = 0
    for element in header.elements:
        checked_count(element.count, 1, len(lines) - at, f"lines of {element.name}")
        rows = lines[at : at + element.count]
        at += element.count
        try:
            data = _lists_of_lines if element.has_lists else _numbers_of_lines
            yield replace(element, data=data(element, rows))
        except (ValueError, OverflowError):
            raise FileError(
                f"expected {len(element.properties)} numbers on each line of "
                f"{element.name}, got something else"
            ) from None


def _numbers_of_lines(element, rows):
    kinds = element.properties
    if not rows:
        return {item.name: np.empty(0, item.type) for item in kinds}
    table = np.loadtxt(rows, ndmin=2, comments=None, usecols=range(len(kinds)))
    return {
        item.name: _exactly(column, item.type)
        for item, column in zip(kinds, table.T, strict=True)
    }


def _exactly(values, kind):
    """Return numbers as a type that can hold them."""
    with np.errstate(over="ignore"):
        return _whole(values, kind) if kind[0] != "f" else values.astype(kind)


def _whole(values, kind):
    limits = np.iinfo(kind)
    if not ((values >= limits.min) & (values <= limits.max)).all():
        raise ValueError("out of range")
    return values.astype(kind)


def _lists_of_lines(element, rows):
    data: dict[str, Any] = {
        item.name: ([], []) if item.count else [] for item in element.properties
    }
    for row in rows:
        tokens = iter(row.split())
        for item in element.properties:
            number = next(tokens, "")
            if item.count is None:
                data[item.name].append(float(number))
                continue
            values, sizes = data[item.name]
            sizes.append(int(number))
            if not 0 <= sizes[-1] <= len(row):
                raise ValueError("out of range")
            values += [float(next(tokens, "")) for _ in range(sizes[-1])]
    return {
        item.name: (
            (
                _exactly(np.array(data[item.name][0], dtype=float), item.type),
                np.array(data[item.name][1], dtype=np.int64),
            )
            if item.count
            else _exactly(np.array(data[item.name], dtype=float), item.type)
        )
        for item in element.properties
    }


def encoded(element: Element, header: Header) -> bytes:
    """Return the rows of an element as they stand in the file."""
    if header.format == "ascii":
        return _as_text(element)
    if not element.has_lists:
        rows = np.empty(element.count, element.dtype(header.order))
        for item in element.properties:
            rows[item.name] = element.data[item.name]
        return rows.tobytes()
    return _as_bytes(element, header.order)


def _as_text(element):
    columns = []
    for item in element.properties:
        values = element.data[item.name]
        if item.count:
            values, sizes = values
            said, ends = values.astype("U").tolist(), np.cumsum(sizes).tolist()
            columns.append(
                [
                    " ".join([str(size), *said[end - size : end]])
                    for size, end in zip(sizes.tolist(), ends, strict=True)
                ]
            )
        else:
            columns.append(values.astype("U").tolist())
    lines = map(" ".join, zip(*columns, strict=True))
    return "".join(line + "\n" for line in lines).encode("ascii")


def _as_bytes(element, order):
    """Return the bytes of rows that differ in length."""
    parts = []  # dtype, values, row of each value, place within the list
    length = np.zeros(element.count, np.int64)
    rows = np.arange(element.count)
    for item in element.properties:
        values, sizes = element.data[item.name], np.ones(element.count, np.int64)
        if item.count:
            values, sizes = values
            kind = np.dtype(order + item.count)
            parts.append((kind, sizes.astype(kind), rows, length.copy()))
            length += kind.itemsize
        kind = np.dtype(order + item.type)
        row = np.repeat(rows, sizes)
        nth = np.arange(len(row)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        parts.append(
            (kind, values.astype(kind), row, length[row] + nth * kind.itemsize)
        )
        length += sizes * kind.itemsize
    octets = np.empty(length.sum(), "u1")
    starts = np.cumsum(length) - length
    for kind, values, row, offset in parts:
        places = (starts[row] + offset)[:, None] + np.arange(kind.itemsize)
        octets[places] = values.view("u1").reshape(-1, kind.itemsize)
    return octets.tobytes()
