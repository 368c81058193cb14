# SPDX-License-Identifier: GPL-3.0-or-later
"""Points as lines of text: XYZ, PTS, PWN, CSV and the like.

Lines are kept as they are, digit for digit; normals are put where the file has some,
or at the end of each line.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .shape import COLORS, NORMALS, FileError, Shape, looks_unit

# Latin-1 has a letter for every byte, so that comments survive in any encoding.
_ENCODING = "latin-1"
# What some programs write first, as it looks in Latin-1.
_MARK = b"\xef\xbb\xbf".decode(_ENCODING)
_COMMENT = ("#", "//", "%", "!")
_SAME = {
    "easting": "x", "northing": "y", "elevation": "z",
    "normal_x": "nx", "normal_y": "ny", "normal_z": "nz",
    "normalx": "nx", "normaly": "ny", "normalz": "nz",
    "r": "red", "g": "green", "b": "blue",
}  # fmt: skip

# Digits that give back a number of single precision.
_NORMAL = "{0:.9g}"
_ROWS = 200_000


@dataclass(frozen=True)
class Table:
    """Lines of a file, and what is in which place of a line.

    Attributes
    ----------
    lines : list of str, without their ends
    rows : (n,) int
        The lines that hold points.
    delimiter : str or None
        None stands for blanks.
    names : list of str
        One for each place; "" where it is not known.
    header : int or None
        The line that holds the names.
    end : str
        The end of the lines.
    mark : str
        What stands before the first line.
    """

    lines: list[str]
    rows: Any
    delimiter: str | None
    names: list[str]
    header: int | None
    end: str
    mark: str


def read(path: Path) -> Shape:
    """Read points with whatever stands behind them on their lines."""
    text = path.read_bytes().decode(_ENCODING)
    mark = _MARK if text.startswith(_MARK) else ""
    text = text.removeprefix(_MARK)
    end = "\r\n" if "\r\n" in text[:4096] else "\n"
    lines = [line.rstrip("\r") for line in text.split("\n")]
    rows = [
        at for at, line in enumerate(lines) if line.strip() and not _is_comment(line)
    ]
    if not rows:
        raise FileError("expected lines of coordinates, got none")
    names, header, count = _names(lines, rows, path)
    rows = rows[rows.index(header) + 1 :] if header in rows else rows
    if count is not None:
        rows = rows[1:]
        if count != len(rows):
            raise FileError(
                f"expected {count:,} points, which its first line announces, "
                f"got {len(rows):,}"
            )
    if not rows:
        raise FileError("expected lines of coordinates, got none")
    delimiter = _delimiter(lines[rows[0]])
    first = _split(lines[rows[0]], delimiter)
    numeric = [at for at, token in enumerate(first) if _is_number(token)]
    if len(numeric) < 3:
        raise FileError(
            f"line {rows[0] + 1}: expected three coordinates, got {_short(first)}"
        )
    values = _numbers(lines, rows, delimiter, numeric)
    if len(names) != len(first):
        names = _guessed(values, numeric, len(first), path)
    table = Table(lines, np.array(rows), delimiter, names, header, end, mark)
    return _shape(table, dict(zip(numeric, values.T, strict=True)))


def _is_comment(line):
    return line.lstrip().startswith(_COMMENT)


def _names(lines, rows, path):
    """Return the names of the columns, the line they are on, and a count of points."""
    first = rows[0]
    tokens = _split(lines[first], _delimiter(lines[first]))
    if not any(_is_number(token) for token in tokens):
        return [_name(token) for token in tokens], first, None
    if path.suffix.lower() == ".pts" and len(tokens) == 1 and tokens[0].isdecimal():
        return [], None, int(tokens[0])
    # "//X,Y,Z,R,G,B": a header behind the sign of a comment.
    above = first - 1
    if above >= 0 and _is_comment(lines[above]):
        said = lines[above].lstrip().lstrip("#/%!").strip()
        names = [_name(token) for token in _split(said, _delimiter(said))]
        if {"x", "y", "z"} <= set(names) and len(names) == len(tokens):
            return names, above, None
    return [], None, None


def _name(token):
    name = token.strip().strip("\"'").lower()
    return _SAME.get(name, name)


def _delimiter(line):
    return next((sign for sign in ",;" if sign in line), None)


def _split(line, delimiter):
    return [token.strip() for token in line.split(delimiter)]


def _is_number(token):
    try:
        float(token)
    except ValueError:
        return False
    return "_" not in token


def _short(tokens):
    said = " ".join(tokens)
    return repr(said if len(said) <= 40 else said[:37] + "...")


def _numbers(lines, rows, delimiter, columns):
    """Return the numbers of some columns, (n, c) float64."""
    try:
        return np.loadtxt(
            (lines[at] for at in rows),
            delimiter=delimiter,
            usecols=columns,
            comments=None,
            ndmin=2,
            encoding=None,
        )
    except ValueError:
        pass
    for at in rows:
        tokens = _split(lines[at], delimiter)
        if not all(c < len(tokens) and _is_number(tokens[c]) for c in columns):
            raise FileError(
                f"line {at + 1}: expected {_a_number(columns)}, got {_short(tokens)}"
            )
    raise FileError("expected numbers, got what is none")


def _a_number(columns):
    places = ", ".join(str(at + 1) for at in columns[:6])
    return f"numbers in columns {places}" + (" ..." if len(columns) > 6 else "")


def _guessed(values, numeric, count, path):
    """Name the columns of a file without a header, "" where there is no telling."""
    names = [""] * count
    known = ["x", "y", "z"]
    width = len(numeric)
    if width >= 6 and looks_unit(values[:, 3:6]):
        known += NORMALS
    elif width >= 6 and looks_unit(values[:, -3:]):
        known += [""] * (width - 6) + list(NORMALS)
    elif path.suffix.lower() == ".pts" and width in (4, 7):
        known += ["intensity", *COLORS][: width - 3]
    elif width >= 6 and _are_bytes(values[:, 3:6]):
        known += COLORS
    for at, name in zip(numeric, known, strict=False):
        names[at] = name
    return names


def _are_bytes(values):
    with np.errstate(invalid="ignore"):
        return bool(((values >= 0) & (values <= 255) & (values % 1 == 0)).all())


def _shape(table, columns):
    """Return the Shape of a table and its numbers by place."""
    place = {name: at for at, name in enumerate(table.names) if name}
    missing = [name for name in "xyz" if place.get(name) not in columns]
    if missing:
        raise FileError(f"expected columns x, y and z, got {_short(table.names)}")

    def rows(names):
        return np.stack([columns[place[name]] for name in names], axis=1)

    has_normals = all(place.get(name) in columns for name in NORMALS)
    rest = {
        name or f"column_{at + 1}": _narrow(name, columns[at])
        for at, name in enumerate(table.names)
        if at in columns and name not in {"x", "y", "z", *NORMALS}
    }
    normals = rows(NORMALS) if has_normals else None
    return Shape(rows("xyz"), None, normals, rest, table)


def _narrow(name, values):
    """Return colors as the bytes that they are."""
    is_color = name in COLORS and len(values) and _are_bytes(values)
    return values.astype("u1") if is_color else values


def write(path: Path, shape: Shape) -> None:
    """Write points and normals, and the rest of each line where it was text before."""
    table = shape.kept
    if isinstance(table, Table) and shape.suffix == path.suffix.lower():
        lines, end = _rewritten(table, shape.normals), table.end
        mark = table.mark
    else:
        lines, end, mark = _new(path.suffix.lower(), shape), "\n", ""
    with path.open("w", encoding=_ENCODING, errors="replace", newline="") as file:
        file.write(mark)
        for at in range(0, len(lines), _ROWS):
            last = at + _ROWS >= len(lines)
            file.write(end.join(lines[at : at + _ROWS]) + ("" if last else end))


def _rewritten(table, normals):
    """Return the lines of a table with other normals."""
    lines, glue = list(table.lines), _glue(table)
    places = [table.names.index(name) for name in NORMALS if name in table.names]
    added = len(places) < 3
    if added and table.header is not None:
        lines[table.header] += glue + glue.join(NORMALS)
    for at, normal in zip(table.rows, normals.tolist(), strict=True):
        said = [_NORMAL.format(value) for value in normal]
        if added:
            lines[at] = lines[at].rstrip() + glue + glue.join(said)
        else:
            tokens = lines[at].split(table.delimiter)
            for place, number in zip(places, said, strict=True):
                tokens[place] = number
            lines[at] = glue.join(tokens)
    return lines


def _glue(table):
    first = table.lines[table.rows[0]]
    return table.delimiter or ("\t" if "\t" in first else " ")


def _new(suffix, shape):
    """Return the lines of a new file."""
    columns = [*shape.points.T, *shape.normals.T]
    glue, head = " ", []
    if suffix == ".csv":
        glue = ","
        columns += shape.columns.values()
        head = [",".join(("x", "y", "z", *NORMALS, *shape.columns))]
    elif suffix == ".pts":
        head = [str(len(shape.points))]
    # As text numpy gives as many digits as tell a number from its neighbors.
    said = [np.asarray(column).astype("U").tolist() for column in columns]
    return [*head, *map(glue.join, zip(*said, strict=True)), ""]
