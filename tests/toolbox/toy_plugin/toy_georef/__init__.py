"""A third party's tools and exporter: what a plug-in author would write."""

import os
import time
from collections.abc import Sequence
from pathlib import Path

from georef_gis.errors import InputError
from georef_gis.toolbox import (
    Algorithm,
    Context,
    Exporter,
    ExportReport,
    Feedback,
    LayerSource,
    Output,
    Result,
    check_cancelled,
)
from georef_gis.toolbox import parameters as p


class CountParameters(p.Parameters):
    """How to count."""

    step: p.Length = p.length(1.0, title="Step", unit="m", ge=0.01, le=10)
    pause: p.Number = p.number(0.0, title="Pause per photo", unit="s", ge=0)
    note: p.File | None = p.file(None, title="A note")


class Count(Algorithm[CountParameters]):
    """Count the photos.

    Writes the number into products/count.txt.
    """

    id, name, group = "count", "Count", "ingest"
    outputs = (Output(name="count", title="Number of photos"),)
    gives = ("count",)
    in_run = True
    uses_settings = ("photos",)

    def inputs(self, context: Context, parameters: CountParameters) -> Sequence[Path]:
        """All photos."""
        return context.require_project().photo_files()

    def run(self, context: Context, parameters: CountParameters, feedback: Feedback) -> Result:
        """Count."""
        project = context.require_project()
        files = project.photo_files()
        rows = []
        for number, file in enumerate(files):
            check_cancelled(feedback)
            feedback.progress(number / len(files), file.name)
            time.sleep(parameters.pause)
            rows.append({"photo_id": file.stem, "name": file.name, "path": str(file)})
        project.database.replace_rows("photo", rows)
        if any(file.stat().st_size == 0 for file in files):
            feedback.warn("a photo is empty")
        target = project.products / "count.txt"
        target.write_text(f"{len(files)} at {parameters.step} m, {os.getpid()}\n")
        return Result(
            outputs={"count": target},
            summary={"products": [str(target)], "gsd_m": 0.0213, "doubts": ["the sun"]},
        )


class DoubleParameters(p.Parameters):
    """How to double."""

    factor: p.Integer = p.integer(2, title="Factor", ge=1)


class Double(Algorithm[DoubleParameters]):
    """Double the count."""

    id, name, group = "double", "Double", "orient"
    needs, gives = ("count",), ("double",)
    in_run = True
    uses_settings = ()

    def run(self, context: Context, parameters: DoubleParameters, feedback: Feedback) -> Result:
        """Double."""
        project = context.require_project()
        number = int((project.products / "count.txt").read_text().split()[0])
        return Result(summary={"double": parameters.factor * number, "covered_m2": 12345.0})


class LookParameters(p.Parameters):
    """What to look at."""

    file: p.File = p.file(title="File to look at", positional=True)
    tilt: p.Angle = p.angle(30.0, title="Tilt", unit="deg", ge=0, le=90)
    mode: p.Choice = p.choice("fast", title="Mode", choices=("fast", "fail", "bug"))


class Look(Algorithm[LookParameters]):
    """Look at a file, without a project."""

    id, name, group = "look_at", "Look at", "measure"
    needs_project = False

    def run(self, context: Context, parameters: LookParameters, feedback: Feedback) -> Result:
        """Look."""
        if parameters.mode == "fail":
            raise InputError("is empty; give another", source=str(parameters.file))
        if parameters.mode == "bug":
            raise ZeroDivisionError("1 / 0")
        feedback.info("looking")
        return Result(summary={"tilt_rad": parameters.tilt, "name": parameters.file.name})


class ListOptions(p.Parameters):
    """How to list."""

    sep: p.Text = p.text(",", title="Separator")


class List(Exporter[ListOptions]):
    """Names of the photos as text."""

    id, name, suffix = "list", "List", ".txt"
    accepts = ("vector",)
    needs = ("count",)

    def write(
        self, source: LayerSource, target: Path, options: ListOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the names."""
        names = [row["name"] for row in source.project.database.rows("photo")]
        target.write_text(options.sep.join(names))
        if "boom" in options.sep:
            raise OSError(28, "No space left on device")
        if "change" in options.sep:
            source.project.database.delete_rows("photo")
        return ExportReport(crs="none", height_kind="none", features=len(names))


ALGORITHMS = (Count, Double, Look)
EXPORTERS = (List,)
