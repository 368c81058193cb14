#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the virtual environments that tests, checks and builds run in.

    environment.py [core] [blender]

`.venv/core` has numpy, scipy, the tools and the optional libraries of the command
line; `.venv/blender-X.Y` has Blender as a Python module and no scipy, so that the
wheel inside the built zip is the one in use. Needs nothing but a Python of 3.8 or
later. Ready environments are left alone, so a second call takes a moment.
"""

import concurrent.futures
import contextlib
import ctypes
import glob
import os
import platform
import shutil
import subprocess
import sys
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
VENVS = os.path.join(ROOT, ".venv")

# Newest first: the core environment takes the first Python that is there.
BLENDERS = (("5.2", "3.13"), ("4.5", "3.11"))

CORE = (
    "numpy>=1.26",
    "scipy==1.17.1",
    "pytest>=9,<10",
    "hypothesis>=6.150,<7",
    "ruff==0.17.*",
    "mypy==2.4.*",
    "fake-bpy-module-latest==20261026",
    "scipy-stubs==1.17.*",
)
# What the command line uses where it is there. Added to an environment that is ready:
# it is not made anew for them.
OPTIONAL = ("laspy[lazrs]>=2.7,<3", "distributed>=2025.1")
BLENDER = ("pytest>=9,<10",)

# What the Blender module links against, and the Debian package that has it.
LIBRARIES = {
    "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libSM.so.6": "libsm6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
}


def say(text):
    print(text, flush=True)


def candidates(version):
    """Places where an interpreter of this version usually stands."""
    home = os.path.expanduser("~")
    pyenv = os.environ.get("PYENV_ROOT", os.path.join(home, ".pyenv"))
    name = "python" + version
    patterns = (
        os.path.join(pyenv, "versions", version + "*", "bin", name),
        os.path.join(home, ".local/share/uv/python/cpython-" + version + "*/bin", name),
        os.path.join("/opt/hostedtoolcache/Python", version + "*", "x64/bin", name),
        os.path.join("/opt/python*/bin", name),
        os.path.join("/usr/local/bin", name),
        os.path.join("/opt/homebrew/bin", name),
        os.path.join("/usr/bin", name),
    )
    yield from filter(None, [shutil.which(name)])
    for pattern in patterns:
        yield from sorted(glob.glob(pattern), reverse=True)
    if shutil.which("uv"):
        found = subprocess.run(
            ["uv", "python", "find", "--no-python-downloads", version],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            universal_newlines=True,
        )
        yield from found.stdout.split("\n")[:1]


def resolve(python, version):
    """The real path of this interpreter, or None where it does not serve.

    It has to start, be that version and be able to make virtual environments: a
    pyenv shim answers only for the active version, Debian's interpreter has no
    ensurepip without python3-venv, and Blender needs the usual build with a GIL.
    """
    probe = (
        "import sys, sysconfig, venv, ensurepip, ssl;"
        "free = sysconfig.get_config_var('Py_GIL_DISABLED');"
        "print('%d.%d' % sys.version_info[:2] + ('t' if free else ''));"
        "print(sys.executable)"
    )
    try:
        answer = subprocess.run(
            [python, "-c", probe],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            universal_newlines=True,
            timeout=60,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    found, _, path = answer.stdout.strip().partition("\n")
    return path if answer.returncode == 0 and found == version else None


def find_python(version):
    resolved = (resolve(python, version) for python in candidates(version) if python)
    return next(filter(None, resolved), None)


def stamp_text(python, requirements):
    return "\n".join((python, *requirements)) + "\n"


def ready(name, requirements, stamp="stamp"):
    """Whether the environment was finished with these very requirements."""
    try:
        with open(os.path.join(VENVS, name, stamp)) as file:
            python, _, rest = file.read().partition("\n")
    except OSError:
        return False
    return os.path.exists(python) and rest == "\n".join(requirements) + "\n"


def run_logged(command, log):
    log.write("$ " + " ".join(command) + "\n")
    log.flush()
    return subprocess.run(command, stdout=log, stderr=subprocess.STDOUT).returncode


def make(name, python, requirements):
    """Make one environment anew; True when everything is installed."""
    folder = os.path.join(VENVS, name)
    os.makedirs(VENVS, exist_ok=True)
    with open(folder + ".log", "w") as log:
        made = run_logged([python, "-m", "venv", "--clear", folder], log) == 0
    if not made:
        return failed(name)
    return install(name, python, requirements, "stamp")


def install(name, python, requirements, stamp):
    """Install into an environment and leave a stamp; True when all of it is there."""
    start = time.time()
    folder = os.path.join(VENVS, name)
    pip = [os.path.join(folder, "bin", "python"), "-m", "pip", "install", "--retries=8"]
    with open(folder + ".log", "a") as log:
        # pip retries a request, not a download that breaks off in the middle.
        for attempt in range(4):
            if run_logged(pip + list(requirements), log) == 0:
                break
            time.sleep(5 * attempt)
        else:
            return failed(name)
    with open(os.path.join(folder, stamp), "w") as file:
        file.write(stamp_text(python, requirements))
    made = "made" if stamp == "stamp" else "added optional libraries to"
    say("  %s .venv/%s in %.0f s (%s)" % (made, name, time.time() - start, python))
    return True


def failed(name):
    """Show the end of the log; False, for the caller to hand on."""
    log_path = os.path.join(VENVS, name) + ".log"
    say("  %s could not be made; the end of %s:" % (name, log_path))
    say(tail(log_path))
    return False


def tail(path, lines=12):
    with open(path, errors="replace") as file:
        return "    " + "    ".join(file.readlines()[-lines:])


def missing_libraries(libraries):
    missing = []
    for library, package in libraries.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            missing.append(package)
    return missing


def install_libraries(libraries=LIBRARIES, user="Blender"):
    """Install what a module links against; True when nothing is missing.

    `libraries` are the names of files and of the Debian packages that have them.
    """
    linux = platform.system() == "Linux"
    missing = missing_libraries(libraries) if linux else []
    if not missing:
        return True
    install = ["apt-get", "install", "-y", "--no-install-recommends", *missing]
    if os.geteuid() != 0 or not shutil.which("apt-get"):
        say(user + " needs system libraries; run: sudo " + " ".join(install))
        return False
    say("  installing " + " ".join(missing))
    options = ["-o", "Acquire::Retries=5", "-o", "DPkg::Lock::Timeout=300", "-qq"]
    quiet = dict(os.environ, DEBIAN_FRONTEND="noninteractive")
    for command in (["apt-get", "update"], install):
        subprocess.run(
            command[:1] + options + command[1:], env=quiet, stdout=subprocess.DEVNULL
        )
    if missing_libraries(libraries):
        say("apt-get could not install them; run: " + " ".join(install))
        return False
    return True


def plan(groups, pythons):
    """The environments that are wanted and possible: name, Python, requirements."""
    newest = next((pythons[v] for _, v in BLENDERS if pythons[v]), None)
    if "core" in groups:
        yield "core", newest, CORE
    for blender, version in BLENDERS if "blender" in groups else ():
        if pythons[version]:
            requirements = ("bpy==%s.*" % blender, *BLENDER)
            yield "blender-" + blender, pythons[version], requirements


@contextlib.contextmanager
def only_one():
    """Let a second call in the same checkout wait for the first."""
    os.makedirs(VENVS, exist_ok=True)
    with open(os.path.join(VENVS, "lock"), "w") as lock:
        if os.name == "posix":
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def explain_missing(pythons):
    for blender, version in BLENDERS:
        if not pythons[version]:
            say("Python %s not found: Blender %s left out." % (version, blender))


def main(groups):
    pythons = {version: find_python(version) for _, version in BLENDERS}
    if not any(pythons.values()):
        say(
            "No Python 3.13 or 3.11 found: install one, with `pyenv install 3.13`, "
            "`uv python install 3.13` or your system's python3.11 and python3.11-venv."
        )
        return 1
    if "blender" in groups:
        explain_missing(pythons)
        if not install_libraries():
            return 1
    with only_one():
        todo = [job for job in plan(groups, pythons) if not ready(job[0], job[2])]
        if todo:
            say("Making %s:" % ", ".join(".venv/" + job[0] for job in todo))
        with concurrent.futures.ThreadPoolExecutor(2) as pool:
            done = list(pool.map(lambda job: make(*job), todo))
        if all(done) and "core" in groups and not ready("core", OPTIONAL, "optional"):
            python = next(job[1] for job in plan(["core"], pythons))
            done.append(install("core", python, OPTIONAL, "optional"))
    return 0 if all(done) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["core", "blender"]))
