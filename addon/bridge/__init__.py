# SPDX-License-Identifier: GPL-3.0-or-later
"""The one door to Blender's memory: objects to arrays, arrays to attributes.

Nobody outside calls the rooms behind it but for `making`, which makes new objects. In
the order in which they build on one another:

arrays          attributes and corners as arrays; the errors
custom_normals  what Blender keeps normals of meshes as
polygons        faces, and turning them over
geometry        shapes and surfaces as they are handed out
objects         which objects are worked on, and in which mode
shapes          points and faces of an object in the world
selections      which points someone means
results         attributes that are left, and the way back
normals         normals that are there, and new ones in their place
beside          a copy beside an object
making          new objects, meshes and curves
"""

from .arrays import AttributeMismatchError, ObjectError
from .beside import add_beside, is_beside, object_beside, remove_beside
from .geometry import Corners, Geometry, Surface
from .normals import (
    read_corner_normals,
    read_facing,
    read_normals,
    read_normals_before,
    read_places,
    read_shaded,
    turn_faces,
    turn_normals,
    turn_over,
    write_estimate,
    write_preview,
)
from .objects import (
    TYPES,
    active_vertex,
    bounds,
    chosen,
    count_points,
    find_object,
    has_targets,
    in_edit_mode,
    is_cloud,
    object_mode,
    shapes_of_scene,
    targets,
    with_progress,
)
from .polygons import Faces
from .results import (
    COLOR,
    COLOR_BESIDE,
    RESULTS,
    check_writable,
    clear_results,
    color_signature,
    has_attribute,
    has_comparison,
    has_estimate,
    is_split,
    read_attribute,
    read_summary,
    record_of,
    values_at,
    write_results,
    write_summary,
)
from .selections import read_selected, read_weight
from .shapes import (
    DRESS,
    fingerprint,
    place_of_point,
    read_faces,
    read_fans,
    read_geometry,
    read_points,
    read_surface,
)

__all__ = [
    "COLOR",
    "COLOR_BESIDE",
    "DRESS",
    "RESULTS",
    "TYPES",
    "AttributeMismatchError",
    "Corners",
    "Faces",
    "Geometry",
    "ObjectError",
    "Surface",
    "active_vertex",
    "add_beside",
    "bounds",
    "check_writable",
    "chosen",
    "clear_results",
    "color_signature",
    "count_points",
    "find_object",
    "fingerprint",
    "has_attribute",
    "has_comparison",
    "has_estimate",
    "has_targets",
    "in_edit_mode",
    "is_beside",
    "is_cloud",
    "is_split",
    "object_beside",
    "object_mode",
    "place_of_point",
    "read_attribute",
    "read_corner_normals",
    "read_faces",
    "read_facing",
    "read_fans",
    "read_geometry",
    "read_normals",
    "read_normals_before",
    "read_places",
    "read_points",
    "read_selected",
    "read_shaded",
    "read_summary",
    "read_surface",
    "read_weight",
    "record_of",
    "remove_beside",
    "shapes_of_scene",
    "targets",
    "turn_faces",
    "turn_normals",
    "turn_over",
    "values_at",
    "with_progress",
    "write_estimate",
    "write_preview",
    "write_results",
    "write_summary",
]
