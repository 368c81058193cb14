# SPDX-License-Identifier: GPL-3.0-or-later
"""What can be written on the command line, and the help that says so."""

import argparse
from pathlib import Path
from textwrap import fill
from typing import Any

from .. import files
from . import options

_LEAST_MEMORY = 500 << 20

# Of the help's own lines; argparse wraps the rest to the terminal.
_WIDTH = 78


def parser(name: str) -> argparse.ArgumentParser:
    """Return the parser of a program of a name; what it finds has `command`."""
    made = argparse.ArgumentParser(
        prog=name,
        description="Normals of meshes and point clouds by calculus on time scales.",
        epilog="Exit codes: 0 done, 1 something could not be processed, 2 wrong usage, "
        "3 normals deviate by more than compare --fail-above allows.",
    )
    commands = made.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for add in (_add_estimate, _add_compare, _add_repair, _add_reproduce):
        add(commands)
    return made


def _add_estimate(commands: Any) -> None:
    parser = _add_on_files(
        commands,
        "estimate",
        "estimate normals and write the files with them",
        "Estimate the normals of point clouds and meshes. Files keep their points, "
        "colors and everything else, and get normals.",
        example="scans/*.ply -o normals/ --report report.json",
    )
    large = parser.add_argument_group("clouds larger than memory (PLY, NPY, LAS, LAZ)")
    large.add_argument(
        "--memory",
        metavar="SIZE",
        type=_size,
        help="work in tiles and use about so much memory, such as 800M or 4G",
    )
    large.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="let the workers of a Dask scheduler do the tiles, such as "
        "tcp://10.0.0.1:8786",
    )
    options.add_settings(parser)


def _add_repair(commands: Any) -> None:
    parser = _add_on_files(
        commands,
        "repair",
        "wind the faces of meshes alike and outward, and estimate their normals",
        "Turn over the faces of meshes that wind against the others or look inward, "
        "and estimate the normals of the vertices.",
        example="model.obj -o repaired.obj",
    )
    options.add_settings(parser)


def _add_compare(commands: Any) -> None:
    parser = _add_on_files(
        commands,
        "compare",
        "compare normals with Delaunay's and with those that count as right",
        "Compare normals with those of a Delaunay triangulation and, where --truth "
        "has them, with true ones. Nothing but a report and a picture is written.",
        example="scan.ply --truth reference.ply --fail-above 5",
        writes=False,
    )
    parser.add_argument(
        "--truth",
        metavar="FILE",
        help="a file with the normals that count as right: over the same points in "
        "the same order, or else of the nearest point",
    )
    parser.add_argument(
        "--normals",
        choices=("estimate", "file"),
        default="estimate",
        help="which normals are compared: the estimate's, or those in the file "
        "(%(default)s)",
    )
    parser.add_argument(
        "--fail-above",
        metavar="DEG",
        type=options.degrees,
        help="exit with 3 when a normal is more degrees from the truth, or without "
        "--truth from what it is compared with",
    )
    parser.add_argument(
        "--signed",
        action="store_true",
        help="count a normal on the wrong side as more than 90 degrees off",
    )
    parser.set_defaults(output=None, format=None, skip_existing=False)
    options.add_settings(parser)


def _add_on_files(
    commands: Any,
    name: str,
    text: str,
    description: str,
    *,
    example: str,
    writes: bool = True,
) -> Any:
    """Add a command with the options that all commands on files share."""
    known = " ".join(files.FORMATS)
    output = " -o OUTPUT" if writes else ""
    parser = commands.add_parser(
        name,
        help=text,
        description=fill(description, _WIDTH),
        usage=f"%(prog)s INPUT...{output} [options]",
        epilog=f"example:\n  %(prog)s {example}\n\n{fill(f'Files: {known}', _WIDTH)}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "inputs",
        metavar="INPUT",
        nargs="+",
        help="files, folders, or patterns such as 'scans/*.ply'",
    )
    if writes:
        _add_output(parser)
    parser.add_argument(
        "--report", metavar="FILE.json", help="write what was found, and what failed"
    )
    parser.add_argument(
        "--image",
        metavar="FILE.png",
        help="write a picture; with several files the name of a folder",
    )
    parser.add_argument(
        "--jobs",
        metavar="N",
        type=_at_least_one,
        default=1,
        help="files at a time, each in a process of its own (%(default)s)",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace files that are there already"
    )
    parser.add_argument("--quiet", action="store_true", help="print errors alone")
    parser.add_argument(
        "--dry-run", action="store_true", help="say what would be done, and do nothing"
    )
    parser.set_defaults(command=name)
    return parser


def _add_output(parser: Any) -> None:
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUTPUT",
        required=True,
        help="the file to write; a folder for several files",
    )
    parser.add_argument(
        "--format",
        metavar="EXT",
        help="format of the files in a folder, such as ply; by default each keeps its "
        "own",
    )
    parser.add_argument(
        "--skip-existing",
        action="store_true",
        help="leave out files whose output is there already",
    )


def _add_reproduce(commands: Any) -> None:
    text = "repeat the paper's experiment: tables, numbers and, in Blender, figures"
    parser = commands.add_parser("reproduce", help=text, description=text)
    parser.add_argument(
        "-o",
        dest="folder",
        metavar="DIR",
        type=Path,
        default=Path("out", "reproduce"),
        help="folder for results.json, results.md and the figures (%(default)s)",
    )
    parser.add_argument(
        "--seeds",
        metavar="N",
        type=_at_least_one,
        default=3,
        help="number of samples drawn of each surface (%(default)s)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace files in DIR")
    parser.add_argument("--quiet", action="store_true", help="print errors alone")
    parser.set_defaults(command="reproduce")


def _at_least_one(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, got {text}")
    return int(text)


def _size(text: str) -> int:
    unit = {"M": 20, "G": 30, "T": 40}.get(text[-1:].upper())
    number = text[:-1] if unit else text
    try:
        size = int(float(number) * (1 << (unit or 0)))
    except ValueError:
        size = 0
    if size < _LEAST_MEMORY:
        raise argparse.ArgumentTypeError(f"expected 500M or more, got {text}")
    return size
