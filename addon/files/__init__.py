# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of points and meshes, by the ends of their names; needs no Blender."""

from dataclasses import dataclass, replace
from glob import has_magic
from importlib import import_module
from pathlib import Path

from .shape import COLORS, FileError, Shape

__all__ = ["FORMATS", "FileError", "Format", "Shape", "format_of", "read", "write"]


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes
    ----------
    name : str
    module, kind : str
        Where `read{kind}` and `write{kind}` are.
    holds_normals : bool
        Whether points have normals in such a file.
    holds_faces, holds_columns : bool
        Whether faces, and numbers by name for each point, can be written.
    needs_blender : bool
        Whether it is a scene of objects: see `commands.scenes`.
    """

    name: str
    module: str
    kind: str = ""
    holds_normals: bool = True
    holds_faces: bool = False
    holds_columns: bool = False
    needs_blender: bool = False


_TEXT = Format("text", "text")
_SCENE = Format("scene", "", holds_faces=True, needs_blender=True)

FORMATS = {
    ".ply": Format("PLY", "ply", holds_faces=True, holds_columns=True),
    ".obj": Format("OBJ", "obj", holds_faces=True),
    ".stl": Format("STL", "stl", holds_normals=False, holds_faces=True),
    ".off": Format("OFF", "off", holds_faces=True),
    ".xyz": _TEXT,
    ".xyzn": _TEXT,
    ".pwn": _TEXT,
    ".asc": _TEXT,
    ".txt": _TEXT,
    ".pts": _TEXT,
    ".csv": Format("CSV", "text", holds_columns=True),
    ".npy": Format("NPY", "arrays", "_npy"),
    ".npz": Format("NPZ", "arrays", "_npz", holds_faces=True, holds_columns=True),
    ".las": Format("LAS", "las", holds_columns=True),
    ".laz": Format("LAZ", "las", holds_columns=True),
    ".pcd": Format("PCD", "pcd", holds_columns=True),
    ".blend": _SCENE,
    ".glb": _SCENE,
    ".gltf": _SCENE,
    ".usd": _SCENE,
    ".usda": _SCENE,
    ".usdc": _SCENE,
    ".usdz": _SCENE,
}


def format_of(path: Path) -> Format:
    """Return the format of a file by the end of its name, or raise FileError."""
    found = FORMATS.get(path.suffix.lower())
    if found is None:
        raise FileError(
            f"expected a file of {', '.join(FORMATS)}, got {path.suffix or 'no ending'}"
        )
    return found


def check_is_file(path: Path) -> None:
    """Raise FileError where there is no file that can be read more than once."""
    if path.is_dir():
        raise FileError(f"expected files of {', '.join(FORMATS)} in it, got none")
    if path.exists() and not path.is_file():
        raise FileError("expected a file, got a pipe or a device")
    if not path.exists() and has_magic(str(path)):
        raise FileError("no file matches the pattern")


def read(path: Path) -> Shape:
    """Read a file.

    Raises
    ------
    FileError
        When it is not there, damaged, or needs a library that is not there.
    """
    check_is_file(path)
    found = format_of(path)
    if found.needs_blender:
        raise FileError(f"expected points or one mesh, got a scene ({path.suffix})")
    try:
        shape = getattr(_module(found), "read" + found.kind)(path)
    except OSError as error:
        raise FileError(f"cannot be read: {error.strerror or error}") from None
    except MemoryError:
        raise FileError("cannot be read: it needs more memory than there is") from None
    if not len(shape.points):
        raise FileError("expected points, got none")
    return replace(shape, suffix=path.suffix.lower())


def write(path: Path, shape: Shape) -> list[str]:
    """Write a shape with its normals; return what the file has no place for."""
    found = format_of(path)
    if found.needs_blender:
        raise FileError(f"expected a file of points as output, got {path.suffix}")
    getattr(_module(found), "write" + found.kind)(path, shape)
    lost = []
    if shape.polygons is not None and not found.holds_faces:
        lost.append("faces")
    # A file of the same kind is written as it was, with all that it had.
    if not found.holds_columns and FORMATS.get(shape.suffix) != found:
        held = COLORS if found.module in ("obj", "off") else ()
        lost += [name for name in shape.columns if name not in held]
    return lost


def _module(found):
    return import_module(f".{found.module}", __package__)
