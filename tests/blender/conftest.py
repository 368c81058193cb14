# SPDX-License-Identifier: GPL-3.0-or-later
"""Install the built zip into a throw-away profile; give every test an empty file.

The extension is there before the test modules are imported, so they can say
`from bl_ext.user_default.timescale_normals import core` at their top.
"""

import os
import sys
import tempfile
from pathlib import Path

import pytest

PROFILE = tempfile.TemporaryDirectory(prefix="timescale-profile-")
# Blender reads this once, when `bpy` is imported.
os.environ["BLENDER_USER_RESOURCES"] = PROFILE.name

import bpy  # noqa: E402 - not before the profile is chosen

MODULE = "bl_ext.user_default.timescale_normals"
CHECKOUT = {"core", "addon"}


def pytest_report_header() -> str:
    """Say which Blender these tests run in."""
    return f"Blender {bpy.app.version_string}, {os.environ.get('TIMESCALE_ZIP')}"


def pytest_sessionstart() -> None:
    """Install the zip named by TIMESCALE_ZIP, as a user would."""
    package = os.environ.get("TIMESCALE_ZIP", "")
    if not Path(package).is_file():
        raise pytest.UsageError(
            "TIMESCALE_ZIP does not name a built zip; run `make test-blender`"
        )
    bpy.ops.extensions.package_install_files(
        filepath=package, repo="user_default", enable_on_install=True
    )
    if MODULE not in bpy.context.preferences.addons:
        raise pytest.UsageError(f"Blender did not enable {package}; see above")


def pytest_sessionfinish() -> None:
    """Leave nothing registered: Blender 4.5 hangs at exit if something stays."""
    if MODULE in bpy.context.preferences.addons:
        bpy.ops.preferences.addon_disable(module=MODULE)
    PROFILE.cleanup()


@pytest.fixture(autouse=True, scope="session")
def _the_installed_one_is_tested():
    """Fail when a test reached into the checkout or used another scipy."""
    yield
    import scipy

    assert Path(scipy.__file__).is_relative_to(PROFILE.name), scipy.__file__
    roots = {name.partition(".")[0] for name in sys.modules}
    assert not roots & CHECKOUT, "a test imported the checkout, not the installed zip"


@pytest.fixture(autouse=True)
def _empty_file():
    """Start from an empty file; 6 ms, and preferences and extensions stay."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


@pytest.fixture
def profile() -> Path:
    """Folder of the throw-away profile."""
    return Path(PROFILE.name)
