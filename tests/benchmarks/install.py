# SPDX-License-Identifier: GPL-3.0-or-later
"""Make `.venv/bench`, where our core and its peers run side by side.

Peers come one by one, so that one without a wheel for this machine does not keep the
others out: what is missing is said in one line.
"""

import subprocess
import sys
from pathlib import Path

# From .ci, which `make bench` puts on the path.
import environment

OURS = ("numpy>=2", "scipy>=1.17", "matplotlib>=3.10")
# Import name and requirement. CGAL's wheels end with Python 3.12, which the others
# have too.
PEERS = {
    "open3d": "open3d>=0.19",
    "small_gicp": "small_gicp>=1.0",
    "meshlib": "meshlib>=3.0",
    "pymeshlab": "pymeshlab>=2023.12",
    "point_cloud_utils": "point-cloud-utils>=0.30",
    "CGAL": "cgal>=6.0",
    "igl": "libigl>=2.5",
    "trimesh": "trimesh>=4",
    "skimage": "scikit-image>=0.24",
    "vtk": "vtk>=9.3",
}
# What Open3D's wheel links against on Linux and does not bring.
LIBRARIES = {"libusb-1.0.so.0": "libusb-1.0-0"}
PYTHONS = ("3.12", "3.11", "3.13")


def main():
    # Where it cannot be had, a line says so, and Open3D is left out.
    environment.install_libraries(LIBRARIES, "Open3D")
    wanted = (*OURS, *PEERS.values())
    if environment.ready("bench", wanted):
        return 0
    python = next(filter(None, map(environment.find_python, PYTHONS)), None)
    if python is None:
        environment.say(f"No Python of {', '.join(PYTHONS)} found: no benchmark.")
        return 1
    with environment.only_one():
        if not environment.make("bench", python, OURS):
            return 1
        missing = [name for name in PEERS if not _install(PEERS[name])]
        stamp = Path(environment.VENVS, "bench", "stamp")
        stamp.write_text(environment.stamp_text(python, wanted))
    if missing:
        environment.say(f"Left out, no wheel could be installed: {', '.join(missing)}")
    return 0


def _install(requirement):
    pip = [Path(environment.VENVS, "bench", "bin", "python"), "-m", "pip", "install"]
    with Path(environment.VENVS, "bench.log").open("a") as log:
        command = [*pip, "--retries=8", "--only-binary=:all:", requirement]
        done = subprocess.run(command, stdout=log, stderr=log, check=False)
    return done.returncode == 0


if __name__ == "__main__":
    sys.exit(main())
