"""The table of a batch: CSV, a page, and a layer of the sites' outlines."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from georef_gis.app.batch.process import Outcome
from georef_gis.errors import ExportError, GeorefError
from georef_gis.project.geopackage import journals_aside
from georef_gis.project.spreadsheet import guarded
from georef_gis.project.summary import SiteSummary
from georef_gis.project.summary_layer import write_summary_layer

CSV, HTML, LAYER = "batch.csv", "batch.html", "batch.gpkg"
# Doubts of a site that are written out; all are in its report.
MOST_DOUBTS = 5
COLUMNS = (
    "site", "state", "photos", "posed", "gsd_m", "covered_m2", "rmse_h_m", "check_points_h",
    "rmse_v_m", "check_points_v", "sigma_horizontal_m", "accuracy", "duration_s", "doubts",
    "first_doubts", "message", "crs", "finished_utc", "folder",
)  # fmt: skip
_HEADS = {
    "site": "Site", "state": "State", "photos": "Photos", "gsd_m": "GSD, cm",
    "covered_m2": "Area, ha", "accuracy": "Accuracy", "duration_s": "Took, s", "doubts": "Doubts",
    "message": "What is wrong",
}  # fmt: skip
_SIGNS = {
    "done": "✓ done", "unchanged": "✓ unchanged", "failed": "✗ failed", "bug": "✗ bug",
    "cancelled": "– cancelled",
}  # fmt: skip
_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.45 system-ui, sans-serif; margin: 1.5rem; }
table { border-collapse: collapse; }
th, td { padding: .35rem .7rem; border-bottom: 1px solid #8884; text-align: left;
  vertical-align: top; }
td:nth-child(2) { white-space: nowrap; }
td.n { text-align: right; font-variant-numeric: tabular-nums; }
tr.failed td, tr.bug td { background: #c622; }
tr.cancelled td { background: #8882; }
details { max-width: 34rem; }
.wrap { overflow-x: auto; }
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One site of the table."""

    outcome: Outcome
    summary: SiteSummary | None

    def values(self) -> dict[str, Any]:
        """By column; None = not known."""
        outcome, facts = self.outcome, self.summary or SiteSummary()
        return {
            "site": outcome.site.name,
            "state": outcome.state,
            "photos": facts.photos,
            "posed": facts.posed,
            "gsd_m": _rounded(facts.gsd_m, 5),
            "covered_m2": _rounded(facts.covered_m2, 1),
            "rmse_h_m": _rounded(facts.rmse_h_m, 4),
            "check_points_h": facts.check_points_h,
            "rmse_v_m": _rounded(facts.rmse_v_m, 4),
            "check_points_v": facts.check_points_v,
            "sigma_horizontal_m": _rounded(facts.sigma_horizontal_m, 4),
            "accuracy": facts.accuracy,
            "duration_s": round(outcome.duration_s, 1),
            "doubts": len(facts.doubts),
            "first_doubts": "; ".join(facts.doubts[:MOST_DOUBTS]),
            "message": outcome.message,
            "crs": facts.crs,
            "finished_utc": facts.finished,
            "folder": str(outcome.site.folder),
        }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def write_tables(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write the three files, each whole or not at all.

    A layer that is open in another program and cannot be replaced does not keep the other two
    from being written.

    Raises
    ------
    ExportError
        If one of them cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    refused: list[str] = []
    for name in (CSV, HTML, LAYER):
        # two batches may write one folder at once
        part = folder / f".{os.getpid()}.{name}.part"
        try:
            _write(name, rows, part)
            with journals_aside(folder / name) if name == LAYER else nullcontext():
                os.replace(part, folder / name)
        except (OSError, GeorefError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            refused.append(f"{folder / name}: cannot be written ({reason})")
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
    if refused:
        raise ExportError("; ".join(refused) + "; close it in other programs, check the permission")
    return [folder / name for name in (CSV, HTML, LAYER)]


def _write(name: str, rows: Sequence[Row], part: Path) -> None:
    if name == CSV:
        # With a byte order mark, as spreadsheets read other CSV by the local code page.
        part.write_text(csv_text(rows), encoding="utf-8-sig", newline="")
    elif name == HTML:
        part.write_text(html_text(rows, part.parent), encoding="utf-8")
    else:
        write_summary_layer(
            part,
            [(row.values(), row.summary.outline_deg if row.summary else None) for row in rows],
        )


def csv_text(rows: Sequence[Row]) -> str:
    """CSV with a head; an apostrophe stands before text that a spreadsheet would calculate."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, COLUMNS)
    writer.writeheader()
    for row in rows:
        writer.writerow({name: _cell(value) for name, value in row.values().items()})
    return stream.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return guarded(value)
    return "" if value is None else value


def html_text(rows: Sequence[Row], folder: Path) -> str:
    """A page with the table; a site's name leads to its report."""
    counts = {state: sum(row.outcome.state == state for row in rows) for state in _SIGNS}
    told = ", ".join(f"{number} {state}" for state, number in counts.items() if number)
    heads = "".join(f'<th scope="col">{escape(head)}</th>' for head in _HEADS.values())
    lines = "\n".join(_html_row(row, folder) for row in rows)
    made = datetime.now(UTC).isoformat(" ", "minutes")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>Batch of {len(rows)} sites</title><style>{_STYLE}</style></head><body>\n"
        f"<h1>Batch of {len(rows)} sites</h1>\n<p>{escape(told)}; {made[:16]} UTC</p>\n"
        f'<div class="wrap"><table><thead><tr>{heads}</tr></thead>\n<tbody>{lines}</tbody>'
        "</table></div>\n</body></html>\n"
    )


def _html_row(row: Row, folder: Path) -> str:
    values = row.values()
    shown = {
        "site": _link(row, folder),
        "state": escape(_SIGNS[values["state"]]),
        "photos": _number(values["photos"], 1.0, 0),
        "gsd_m": _number(values["gsd_m"], 100.0, 2),
        "covered_m2": _number(values["covered_m2"], 1e-4, 2),
        "accuracy": escape(values["accuracy"]),
        "duration_s": _number(values["duration_s"], 1.0, 1),
        "doubts": _doubts(row),
        "message": escape(values["message"]),
    }
    numbers = ("photos", "gsd_m", "covered_m2", "duration_s")
    cells = "".join(
        f'<td class="n">{shown[name]}</td>' if name in numbers else f"<td>{shown[name]}</td>"
        for name in _HEADS
    )
    return f'<tr class="{values["state"]}">{cells}</tr>'


def _link(row: Row, folder: Path) -> str:
    site = row.outcome.site
    report = site.folder / "products" / "report.html"
    if not report.is_file():
        return escape(site.name)
    try:
        address = quote(Path(os.path.relpath(report, folder)).as_posix())
    except ValueError:
        # on Windows: on another drive
        address = report.as_uri()
    return f'<a href="{escape(address)}">{escape(site.name)}</a>'


def _number(value: float | None, scale: float, digits: int) -> str:
    return "" if value is None else f"{value * scale:.{digits}f}"


def _doubts(row: Row) -> str:
    doubts = row.summary.doubts if row.summary else ()
    if not doubts:
        return "0"
    items = "".join(f"<li>{escape(doubt)}</li>" for doubt in doubts[:MOST_DOUBTS])
    more = len(doubts) - MOST_DOUBTS
    rest = f"<li>and {more} more in its report</li>" if more > 0 else ""
    return f"<details><summary>{len(doubts)}</summary><ul>{items}{rest}</ul></details>"
