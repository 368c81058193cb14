# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY: text and binary, both byte orders, every element and property kept."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from .ply_header import NAMES, Element, Header, Property, header_text, read_header
from .ply_rows import elements_of, encoded
from .shape import COLORS, NORMALS, FileError, Polygons, Shape, checked

_FACES = ("vertex_indices", "vertex_index")


def read(path: Path) -> Shape:
    """Read the vertices, their properties and the faces."""
    with path.open("rb") as file:
        header = read_header(file)
        file.seek(header.size)
        body = file.read()
    return shape_of(replace(header, elements=tuple(elements_of(header, body))))


def shape_of(header: Header) -> Shape:
    """Return the Shape of elements that have been read."""
    vertex = vertex_element(header)
    columns = dict(vertex.data)
    points = np.stack([_native(columns.pop(name)) for name in "xyz"], axis=1)
    normals = None
    if set(NORMALS) <= set(columns):
        normals = np.stack([_native(columns.pop(name)) for name in NORMALS], axis=1)
    columns = {name: _native(values) for name, values in columns.items()}
    return checked(Shape(points, _polygons(header), normals, columns, header))


def vertex_element(header: Header) -> Element:
    """Return the element of the vertices, with plain numbers x, y and z."""
    for element in header.elements:
        if element.name == "vertex":
            names = {item.name for item in element.properties}
            if not {"x", "y", "z"} <= names:
                raise FileError("expected vertices with x, y and z")
            if element.has_lists:
                raise FileError("expected vertices without lists of numbers")
            return element
    raise FileError("expected an element vertex, got none")


def _native(values):
    """Return numbers in the byte order of this machine; coordinates as floats."""
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))


def _polygons(header):
    for element in header.elements:
        for item in element.properties:
            if element.name == "face" and item.name in _FACES and item.count:
                values, sizes = element.data[item.name]
                return Polygons(values.astype(np.int64), sizes.astype(np.int64))
    return None


def write(path: Path, shape: Shape) -> None:
    """Write a shape, as it was where it came from a PLY file."""
    header = shape.kept if isinstance(shape.kept, Header) else _new(shape)
    header = _with_normals(header, shape.normals)
    if shape.polygons is not None:
        header = _with_faces(header, shape.polygons)
    with path.open("wb") as file:
        file.write(header_text(header))
        for element in header.elements:
            file.write(encoded(element, header))


def with_normals(element: Element) -> Element:
    """Return the element of vertices with places for normals, as precise as x."""
    known = {item.name: item for item in element.properties}
    kind = known["x"].type if known["x"].type[0] == "f" else "f4"
    added = tuple(Property(name, kind) for name in NORMALS if name not in known)
    return replace(element, properties=element.properties + added)


def _with_normals(header, normals):
    vertex = with_normals(vertex_element(header))
    kinds = {item.name: item.type for item in vertex.properties}
    data = dict(vertex.data)
    for name, values in zip(NORMALS, normals.T, strict=True):
        data[name] = values.astype(kinds[name])
    return _replaced(header, replace(vertex, data=data))


def _replaced(header, element):
    elements = (element if e.name == element.name else e for e in header.elements)
    return replace(header, elements=tuple(elements))


def _with_faces(header, polygons):
    for element in header.elements:
        for item in element.properties:
            if element.name == "face" and item.name in _FACES and item.count:
                corners = polygons.corners.astype(item.type)
                data = dict(element.data) | {item.name: (corners, polygons.sizes)}
                return _replaced(header, replace(element, data=data))
    return header


def _new(shape):
    """Return the header and elements of a shape from another format."""
    columns = dict(zip("xyz", shape.points.T, strict=True)) | {
        name.replace(" ", "_"): _storable(name, values)
        for name, values in shape.columns.items()
    }
    kinds = tuple(Property(name, v.dtype.str[1:]) for name, v in columns.items())
    elements = [Element("vertex", len(shape.points), kinds, columns)]
    if shape.polygons is not None:
        faces = shape.polygons
        kind = "u1" if faces.sizes.max(initial=0) < 256 else "i4"
        data = {_FACES[0]: (faces.corners.astype("i4"), faces.sizes)}
        item = Property(_FACES[0], "i4", kind)
        elements.append(Element("face", len(faces.sizes), (item,), data))
    return Header("binary_little_endian", (), tuple(elements))


def _storable(name, values):
    """Return values as a type that PLY has."""
    if name in COLORS and values.dtype.kind == "f" and values.max(initial=0) > 1:
        return values.astype("u1")
    if values.dtype.str[1:] in NAMES:
        return values
    if values.dtype.kind in "ib" and np.abs(values).max(initial=0) < 2**31:
        return values.astype("i4")
    return values.astype("f8")
