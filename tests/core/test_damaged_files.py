# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged files of every format end in a sentence: no traceback, hang or flood.

Whole files are cut short, have bytes changed, and have the numbers of their headers
replaced by others. What reads them may use so much memory and time, and no more.
"""

import contextlib
import re
import signal
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from addon import files
from addon.files.shape import Polygons, Shape

resource = pytest.importorskip("resource", reason="limits of memory are POSIX's")

# Files here have some kilobytes; a lie of a header would ask for gigabytes.
MEMORY = 256 << 20
SECONDS = 20
SUFFIXES = [name for name, kind in files.FORMATS.items() if not kind.needs_blender]
# Headers, and what follows them, are where counts stand.
HEAD = 2000


def sample(suffix: str, kind: int) -> bytes:
    """A whole file: of points with colors, or of a mesh where the format has faces."""
    rng = np.random.default_rng(kind)
    points = rng.uniform(-9, 9, (12, 3))
    columns = {"red": np.arange(12, dtype="u1"), "intensity": np.arange(12, dtype="u2")}
    polygons = None
    if files.FORMATS[suffix].holds_faces and (kind or suffix == ".stl"):
        polygons = Polygons(
            np.array([0, 1, 2, 2, 3, 4, 5, 6, 7, 8]), np.array([3, 4, 3])
        )
    shape = Shape(points, polygons, np.tile([0.0, 0.6, 0.8], (12, 1)), columns)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a" + suffix)
        files.write(path, shape)
        return path.read_bytes()


def text_of_ply() -> bytes:
    head = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n"
    head += b"property float y\nproperty double z\nelement face 1\n"
    head += b"property list uchar int vertex_indices\nend_header\n"
    return head + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


def packed_pcd() -> bytes:
    data = b"\x1f" + bytes(range(32)) + b"\x0f" + bytes(16)
    head = b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\n"
    head += b"HEIGHT 1\nPOINTS 4\nDATA binary_compressed\n"
    sizes = np.array([len(data), 48], "<u4").tobytes()
    return head + sizes + data


def text_of_pcd() -> bytes:
    head = b"FIELDS x y z c\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 2\nWIDTH 2\n"
    return head + b"HEIGHT 1\nPOINTS 2\nDATA ascii\n0 0 0 1 2\n1 nan 0 3 4\n"


def text_of_stl() -> bytes:
    loop = b"outer loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
    return b"solid a\nfacet normal 0 0 1\n" + loop + b"endfacet\nendsolid\n"


WHOLE = {
    **{
        f"{kind}{suffix}": sample(suffix, kind)
        for suffix in SUFFIXES
        for kind in (0, 1)
    },
    "text.ply": text_of_ply(),
    "packed.pcd": packed_pcd(),
    "text.pcd": text_of_pcd(),
    "text.stl": text_of_stl(),
    "header.csv": b"id;X;Y;Z;name\n1;0;0;0;a\n2;1,5;0;1;b\n3;1;1;1;c\n",
    "faces.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\nf -1 -2 -3\n",
}


@contextlib.contextmanager
def limited():
    """Let what runs inside have so much more memory and time, and no more."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)

    def too_long(_signal, _frame):
        raise AssertionError(f"not done after {SECONDS} s")

    before = signal.signal(signal.SIGALRM, too_long)
    resource.setrlimit(
        resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard)
    )
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGALRM, before)


def read_again(name: str, data: bytes) -> None:
    """Read bytes as a file; anything but points or a sentence is a failure."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        try:
            with limited(), np.errstate(all="ignore"):
                shape = files.read(path)
                faces = shape.faces
        except files.FileError as error:
            told = str(error)
            assert "more memory" not in told
            assert "\n" not in told
            assert 10 < len(told) < 400
        else:
            assert shape.points.shape[1] == 3
            assert faces is None or faces.max() < len(shape.points)


def number_replaced(data: bytes, which: int, by: bytes) -> bytes:
    found = list(re.finditer(rb"\d+", data[:HEAD]))
    if not found:
        return data
    at = found[which % len(found)]
    return data[: at.start()] + by + data[at.end() :]


def word_replaced(data: bytes, at: int, by: bytes) -> bytes:
    at %= max(1, min(len(data), HEAD))
    return data[:at] + by + data[at + len(by) :]


def bytes_changed(data: bytes, changes: list[tuple[int, int]]) -> bytes:
    changed = bytearray(data)
    for at, value in changes:
        changed[at % len(changed)] = value
    return bytes(changed)


SPAN = st.integers(0, 1 << 20)
NUMBERS = st.sampled_from(
    [b"0", b"-1", b"1", b"255", b"65536", b"2147483648", b"4294967295"]
    + [b"999999999999", b"9223372036854775807", b"9" * 30, b"1e9", b"nan", b""]
)
WORDS = st.sampled_from(
    [b"\xff" * 4, b"\xff" * 8, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0" * 8]
    + [b"\x00\x00\x00\x40", b"\xff\xff\xff\xff\xff\xff\xff\x7f"]
)
DAMAGE = st.one_of(
    SPAN.map(lambda at: lambda data: data[: at % (len(data) + 1)]),
    st.tuples(SPAN, NUMBERS).map(lambda p: lambda data: number_replaced(data, *p)),
    st.tuples(SPAN, WORDS).map(lambda p: lambda data: word_replaced(data, *p)),
    st.lists(st.tuples(SPAN, st.integers(0, 255)), min_size=1, max_size=9).map(
        lambda changes: lambda data: bytes_changed(data, changes)
    ),
    st.binary(max_size=60).map(lambda other: lambda _data: other),
)


@pytest.mark.parametrize("name", WHOLE)
def test_whole_ones_are_read(name):
    read_again(name, WHOLE[name])


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", WHOLE)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(damage=DAMAGE)
def test_damaged_ones_end_in_a_sentence(name, damage):
    read_again(name, damage(WHOLE[name]))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", WHOLE)
def test_cut_short_anywhere(name):
    data = WHOLE[name]
    for at in range(0, len(data), max(1, len(data) // 100)):
        read_again(name, data[:at])
