# SPDX-License-Identifier: GPL-3.0-or-later
"""Repeat the paper's experiment with the built zip: `make reproduce`.

Installs the zip into a throw-away Blender profile and runs its command there, so that
numbers and figures are those of what is shipped. Then brings `docs/results.md`, between
its markers, and `docs/images/` up to date.
"""

import argparse
import json
import re
import shutil
import sys
from pathlib import Path

# Beside this file. It chooses the throw-away profile before it imports Blender.
import demo

DOCS = Path(__file__).parent


def refresh(page: str, sections: dict[str, str]) -> str:
    """Return the page with the text between its markers replaced.

    The markers of a section are `<!-- begin Title -->` and `<!-- end Title -->`.
    """
    for title, text in sections.items():
        begin, end = f"<!-- begin {title} -->", f"<!-- end {title} -->"
        if begin not in page or end not in page:
            raise ValueError(f"docs/results.md has no markers for {title}")
        old = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
        page = old.sub(lambda _, new=f"{begin}\n\n{text}\n\n{end}": new, page)
    return page


def update(folder: Path) -> None:
    """Bring the documentation up to date with the results in a folder."""
    results = json.loads((folder / "results.json").read_text("utf-8"))
    page = DOCS / "results.md"
    sections = demo.part("addon.paper.tables").sections(results)
    page.write_text(refresh(page.read_text("utf-8"), sections), "utf-8")
    images = DOCS / "images"
    images.mkdir(exist_ok=True)
    for name in demo.part("addon.paper.results").FIGURES:
        shutil.copyfile(folder / name, images / name)


def main() -> int:
    """Run as a command, with the exit code of the extension's."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--zip", type=Path, required=True, help="the built extension")
    parser.add_argument("-o", dest="folder", type=Path, default=Path("out/reproduce"))
    parser.add_argument("--seeds", default="3", help="samples of each surface")
    arguments = parser.parse_args()
    try:
        demo.install(arguments.zip)
        command = ["reproduce", "--overwrite", "-o", str(arguments.folder)]
        code = demo.part("addon.cli").main([*command, "--seeds", arguments.seeds])
        if code == 0:
            update(arguments.folder)
            print("docs/results.md and docs/images/ are up to date.")
        return code
    finally:
        # Blender 4.5 hangs at exit where something stays registered.
        if demo.MODULE in demo.bpy.context.preferences.addons:
            demo.bpy.ops.preferences.addon_disable(module=demo.MODULE)


if __name__ == "__main__":
    sys.exit(main())
