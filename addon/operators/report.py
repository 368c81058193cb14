# SPDX-License-Identifier: GPL-3.0-or-later
"""What the last runs said, for the clipboard and for files."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty, StringProperty
from bpy.types import Context, Event, Operator
from bpy_extras.io_utils import ExportHelper

from .. import bridge
from ..settings.scene import Returned

Rows = list[dict[str, Any]]


def rows_of(context: Context) -> Rows:
    """Return one flat row for every selected object with a result."""
    rows = []
    for obj in bridge.targets(context):
        summary = bridge.read_summary(obj)
        if summary:
            row = {"object": obj.name}
            for part in summary.values():
                row |= part
            rows.append(row)
    return rows


def as_text(rows: Rows, kind: str) -> str:
    """Return rows as a "CSV" table or a "JSON" list."""
    if kind == "JSON":
        return json.dumps(rows, indent=2) + "\n"
    out = io.StringIO()
    # Objects that were compared have more columns than those that were not.
    columns = dict.fromkeys(key for row in rows for key in row)
    writer = csv.DictWriter(out, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


class _OnResults(Operator):
    @classmethod
    def poll(cls, context: Context) -> bool:
        """Ask for results."""
        if any(bridge.read_summary(obj) for obj in bridge.chosen(context)):
            return True
        cls.poll_message_set("Estimate or compare normals first")
        return False


class TIMESCALE_OT_copy_report(_OnResults):
    """Results of the selected objects for a spreadsheet."""

    bl_idname = "timescale.copy_report"
    bl_label = "Copy Report"
    bl_description = "Put the results of selected objects into the clipboard, as CSV"

    def execute(self, context: Context) -> Returned:
        """Copy them."""
        context.window_manager.clipboard = as_text(rows_of(context), "CSV")
        self.report({"INFO"}, "Results copied")
        return {"FINISHED"}


class TIMESCALE_OT_export_report(_OnResults, ExportHelper):
    """Results of the selected objects in a file."""

    bl_idname = "timescale.export_report"
    bl_label = "Export Report"
    bl_description = "Write the results of selected objects to a CSV or JSON file"

    filename_ext = ".csv"
    kind: EnumProperty(
        name="Format",
        description="What the file is to be read by",
        items=[
            ("CSV", "CSV", "A table with a row for each object, for spreadsheets"),
            ("JSON", "JSON", "A list with an item for each object, for scripts"),
        ],
        default="CSV",
    )
    filter_glob: StringProperty(
        name="Filter",
        description="Names of files that are listed",
        default="*.csv;*.json",
        options={"HIDDEN"},
    )

    def invoke(self, context: Context, event: Event) -> Returned:
        """Ask for the file."""
        self.filename_ext = f".{self.kind.lower()}"
        return super().invoke(context, event)

    def check(self, _context: Context) -> bool:
        """Let the name of the file follow the format."""
        options: Any = self
        before = Path(options.filepath)
        path = before.with_suffix(f".{self.kind.lower()}")
        options.filepath = str(path)
        return path != before

    def execute(self, context: Context) -> Returned:
        """Write it, whole or not at all."""
        options: Any = self
        path = Path(bpy.path.abspath(options.filepath))
        part = path.with_name(path.name + ".part")
        try:
            part.write_text(as_text(rows_of(context), self.kind), "utf-8")
            part.replace(path)
        except OSError as error:
            part.unlink(missing_ok=True)
            self.report({"ERROR"}, f"{path}: {error.strerror}")
            return {"CANCELLED"}
        self.report({"INFO"}, f"Results written to {path.name}")
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory(
    (TIMESCALE_OT_copy_report, TIMESCALE_OT_export_report)
)
