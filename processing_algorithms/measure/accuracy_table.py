"""Tool `accuracy_table`: the accuracy statement for any table of residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.measure.accuracy.product import Assessment, CheckResidual, Targets
    from georef_gis.measure.accuracy.report import AccuracyReport, Survey

JSON, TEXT = "accuracy.json", "accuracy.txt"
_COLUMNS = ("name", "dx", "dy", "dz")
_FURTHER = ("sigma_h_m", "sigma_v_m", "x", "y", "cover")
OUTPUTS = (
    Output(name="json", title="Everything, as JSON"),
    Output(name="text", title="Statement and account"),
)


class AccuracyTableParameters(p.Parameters):
    """Parameters of `accuracy_table`."""

    table: p.File = p.file(title="CSV of residuals: name, dx, dy, dz in m", positional=True)
    target_rmse_h: p.Length | None = p.length(
        None, title="Horizontal class (RMSE_H) declared before the test", unit="m", gt=0, le=1000
    )
    target_rmse_v: p.Length | None = p.length(
        None, title="Vertical class (RMSE_V) declared before the test", unit="m", gt=0, le=1000
    )
    target: p.Folder | None = p.folder(
        None, title="Folder for the statement, JSON and pictures", writes=True
    )


class AccuracyTable(Algorithm[AccuracyTableParameters]):
    """Accuracy statement for a table of residuals, without a project.

    The table is a CSV: name, dx, dy, dz (product minus survey, m; empty where not tested) and, if
    known, sigma_h_m, sigma_v_m (of the survey, per axis), x, y (m), cover (open or vegetated).
    """

    id, name, group = "accuracy_table", "Accuracy statement of a table", "measure"
    about = "points"
    needs_project = False
    outputs = OUTPUTS

    def run(
        self, context: Context, parameters: AccuracyTableParameters, feedback: Feedback
    ) -> Result:
        """Judge and tell, and write if a folder is named."""
        from georef_gis.measure.accuracy.report import AccuracyReport
        from georef_gis.measure.accuracy.statement import statement_text

        report = AccuracyReport(
            title=parameters.table.name,
            assessments=(assessment_of_table(parameters.table, targets_of(parameters)),),
            survey=_survey_of_table(parameters.table),
        )
        for line in statement_text(report).splitlines():
            feedback.info(line)
        outputs: dict[str, Path] = {}
        if parameters.target is not None:
            outputs = write_statement(report, parameters.target)
        return Result(outputs=outputs, summary=account_of(report, outputs))


# -- a table -------------------------------------------------------------------------------------


def targets_of(parameters: Any) -> Targets:
    """Classes that the parameters `target_rmse_h` and `target_rmse_v` declare."""
    from georef_gis.measure.accuracy.product import Targets

    return Targets(horizontal=parameters.target_rmse_h, vertical=parameters.target_rmse_v)


def assessment_of_table(path: Path, targets: Targets) -> Assessment:
    """Assessment of a CSV of residuals."""
    from georef_gis.measure.accuracy.product import assess

    return assess(read_residuals(path), targets, kind="table", measured_on={"residuals": path.name})


def _survey_of_table(path: Path) -> Survey:
    """What `# datum: NAD83(2011)@2010.0` and the like above the columns say."""
    from georef_gis.ingest.tables import read_lines
    from georef_gis.measure.accuracy.report import Survey

    header = read_lines(path).header
    return Survey(
        datum=header.get("datum", "unknown"),
        product_datum=header.get("product_datum", "unknown"),
        heights=header.get("height_kind", "unknown"),
        crs=header.get("crs", "unknown"),
    )


def read_residuals(path: Path) -> list[CheckResidual]:
    """Residuals of a CSV: name, dx, dy, dz, m; further columns as `AccuracyTable` tells.

    Raises
    ------
    InputError
        Naming file, line, column and cure.
    """
    from georef_gis.errors import InputError
    from georef_gis.ingest.tables import Row, read_lines, separator_of, split

    data = read_lines(path).data
    separator = separator_of(data[0][1]) if data else ","
    names = [cell.strip().lower() for cell in split(data[0][1], separator)] if data else []
    missing = [column for column in _COLUMNS if column not in names]
    if missing:
        raise InputError(
            f"has no column {', '.join(missing)}; the first line must name {', '.join(_COLUMNS)}",
            source=str(path),
        )
    columns = {name: i for i, name in enumerate(names)}
    out: dict[str, CheckResidual] = {}
    for line, text in data[1:]:
        row = Row(path=path, line=line, cells=split(text, separator), columns=columns)
        one = _residual(row)
        if one.name in out:
            raise InputError(f"point '{one.name}' stands twice", source=row.source, field="name")
        out[one.name] = one
    if not out:
        raise InputError("holds no residuals below its columns", source=str(path))
    return list(out.values())


def _residual(row: Any) -> CheckResidual:
    from georef_gis.errors import InputError
    from georef_gis.measure.accuracy.product import CheckResidual

    values = {key: row.number(key) for key in (*_COLUMNS[1:], *_FURTHER[:4])}
    dx, dy, dz, sigma_h, sigma_v, x, y = (math.nan if v is None else v for v in values.values())
    cover: Any = row.text("cover").lower() or "open"
    name = row.text("name")
    wrong = None
    if not name:
        wrong = "name", "is missing"
    elif cover not in ("open", "vegetated"):
        wrong = "cover", f"'{cover}' is not open or vegetated"
    elif math.isfinite(dx) != math.isfinite(dy):
        wrong = "dx, dy", "one of the two is missing; give both or none"
    elif not (math.isfinite(dx) or math.isfinite(dz)):
        wrong = "dx, dy, dz", "are all missing; remove the line"
    elif sigma_h < 0 or sigma_v < 0:
        wrong = "sigma_h_m, sigma_v_m", "is negative; a standard deviation is not"
    if wrong:
        raise InputError(wrong[1], source=row.source, field=wrong[0])
    return CheckResidual(
        name=name, dx=dx, dy=dy, dz=dz, sigma_h=sigma_h, sigma_v=sigma_v, x=x, y=y, cover=cover
    )


# -- what is written -----------------------------------------------------------------------------


def write_statement(report: AccuracyReport, folder: Path) -> dict[str, Path]:
    """Write the statement, the JSON and the pictures; pictures of an older one are removed."""
    import json

    from georef_gis.measure.accuracy.metadata import statement_json
    from georef_gis.measure.accuracy.plots import accuracy_pictures
    from georef_gis.measure.accuracy.statement import statement_text
    from georef_gis.rasters.files import export_errors, whole_file

    told = json.dumps(statement_json(report), indent=2, allow_nan=False) + "\n"
    files = {JSON: told.encode(), TEXT: statement_text(report).encode()}
    files |= accuracy_pictures(report)
    with export_errors(folder, lambda: sum(map(len, files.values()))):
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("accuracy_*_*.png"):
            if old.name not in files:
                old.unlink()
        for name, content in files.items():
            with whole_file(folder / name) as stream:
                stream.write(content)
    return {"json": folder / JSON, "text": folder / TEXT}


def account_of(report: AccuracyReport, outputs: Mapping[str, Path]) -> dict[str, Any]:
    """Figures of the run's record, and doubts where something was tested."""
    from georef_gis.measure.accuracy.report import report_flags
    from georef_gis.measure.accuracy.sentences import sentence, statement_components

    main = report.main
    tested = {c.name: c for c in main.components if c.n and not c.vegetated}
    out: dict[str, Any] = {"products": [str(path) for path in outputs.values()]}
    for name, c in tested.items():
        key = name.lower()
        out[f"rmse_{key}_m"], out[f"check_points_{key}"] = round(c.rmse, 4), c.n
    if report.distances:
        out["sigma_of_distances_m"] = {f"{a:g} m": round(b, 4) for a, b in report.distances}
    out["statement"] = " ".join(sentence(c) for c in statement_components(main) if c.name != "3D")
    if tested:
        flags = report_flags(report)
        out["doubts"] = [flag.text for flag in (*flags[main.kind], *flags["survey"])]
    return out
