# SPDX-License-Identifier: GPL-3.0-or-later
"""What the numbers in a report were made with."""

import platform
import sys
import tomllib
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np


def versions() -> dict[str, str | None]:
    """Return name to version, of this program and of what it runs on."""
    manifest = Path(__file__).parents[2] / "blender_manifest.toml"
    blender = None
    if find_spec("bpy"):
        import bpy

        blender = bpy.app.version_string
    return {
        "timescale_normals": tomllib.loads(manifest.read_text("utf-8"))["version"],
        "blender": blender,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": version("scipy"),
        "platform": f"{sys.platform} {platform.machine()}",
    }
