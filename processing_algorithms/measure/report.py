"""Tool `report`: one page that shows what was made and how good it is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.measure.report.build import Beside
    from georef_gis.measure.report.facts import Facts, Heights
    from georef_gis.measure.report.page import Section
    from georef_gis.project import Project
    from processing_algorithms.site import Site

REPORT, PDF = "report.html", "report.pdf"
# cells along the longer side of the picture of the relief
RELIEF_CELLS = 420


class ReportParameters(p.Parameters):
    """Parameters of `report`."""

    pdf: p.Flag = p.flag(
        False,
        title="Write products/report.pdf too",
        help='needs reportlab: pip install "georef-gis[pdf]"',
    )


class Report(Algorithm[ReportParameters]):
    """One HTML page of the project, and a PDF: flight, overlap, residuals, accuracy, assets.

    The page needs no network and no other file, and prints. Each figure says what to look for and
    what was found; what asks for a look stands at the top.
    """

    id, name, group = "report", "Report page", "measure"
    version = "2"
    outputs = (
        Output(name="report", title="Report page"),
        Output(name="pdf", title="The same as PDF"),
    )
    needs, gives = ("footprints",), ("report",)
    wants = ("trajectory", "adjusted", "mosaic", "orthos", "control", "accuracy")
    in_run = True
    uses_quick = True

    def inputs(self, context: Context, parameters: ReportParameters) -> Sequence[Path]:
        """What the adjustment and the products left as files, and the assets."""
        project = context.require_project()
        names = ("report.json", "residuals.npz", "points.npz", "matches.json", "surface.npz")
        files = [project.adjustment / name for name in names] if not context.quick else []
        files += [project.products / n for n in ("overlap.tif", "mosaic.tif", "accuracy.json")]
        files += [project.folder / "assets.gpkg", project.navigation / "trajectory.csv"]
        return [path for path in files if path.is_file()]

    def run(self, context: Context, parameters: ReportParameters, feedback: Feedback) -> Result:
        """Read, draw, write."""
        from georef_gis.measure.report.build import report_page, report_sections
        from georef_gis.measure.report.facts import read_facts
        from georef_gis.measure.report.page import count_verdicts
        from processing_algorithms.site import load_site

        project = context.require_project()
        facts = read_facts(project, quick=context.quick)
        for line in facts.missing:
            feedback.warn(line)
        site = load_site(project, quick=context.quick)
        heights = _heights(site, facts)
        beside = _beside(project, site, facts, feedback, quick=context.quick)

        def told(share: float, what: str) -> None:
            check_cancelled(feedback)
            feedback.progress(0.3 + (0.4 if parameters.pdf else 0.65) * share, what)

        sections = report_sections(facts, heights, told, beside)
        page = report_page(facts, sections, made=_now(), versions=_versions())
        target = project.products / REPORT
        # a name that is no text must not cost the page
        size = _write(target, page.encode("utf-8", "replace"))
        outputs = {"report": target}
        summary: dict[str, Any] = {"products": [str(target)], **count_verdicts(sections)}
        summary["size_kb"] = round(size / 1024)
        if parameters.pdf:
            outputs["pdf"], found = _pdf(project, facts, sections, feedback)
            summary["products"].append(str(outputs["pdf"]))
            summary |= found
        return Result(outputs=outputs, summary=summary)


def _beside(
    project: Project, site: Site, facts: Facts, feedback: Feedback, *, quick: bool
) -> Beside:
    from georef_gis.measure.report.build import Beside
    from processing_algorithms.measure.report_flight import flown
    from processing_algorithms.measure.report_parts import assets_of, budget_of, made_by

    feedback.progress(0.05, "flight")
    flight = flown(project, facts, quick=quick)
    check_cancelled(feedback)
    feedback.progress(0.15, "error budget")
    budget, no_budget = budget_of(project, site)
    check_cancelled(feedback)
    feedback.progress(0.25, "assets")
    assets, no_assets = assets_of(project)
    for line in filter(None, (no_budget, no_assets)):
        feedback.warn(line)
    return Beside(
        flown=flight, budget=budget, no_budget=no_budget, assets=assets, no_assets=no_assets,
        made=made_by(project, facts),
    )  # fmt: skip


def _write(target: Path, content: bytes) -> int:
    """Write a file whole or not at all; bytes."""
    from georef_gis.rasters.files import export_errors, whole_file

    with export_errors(target, lambda: len(content)), whole_file(target) as stream:
        stream.write(content)
    return len(content)


def _pdf(
    project: Project, facts: Facts, sections: list[Section], feedback: Feedback
) -> tuple[Path, dict[str, Any]]:
    """Write the PDF; the page is written by then, whatever fails here.

    Raises
    ------
    InputError
        If the library cannot be used.
    """
    from georef_gis.measure.report.build import report_pdf
    from georef_gis.measure.report.pdf_library import require_reportlab

    require_reportlab(beside=REPORT)
    feedback.progress(0.75, "pdf")
    pdf = report_pdf(facts, sections, made=_now(), versions=_versions())
    if pdf.missing:
        feedback.warn(
            f"the PDF shows {len(pdf.missing)} characters as boxes, as no font here has them: "
            f"{' '.join(pdf.missing[:12])}; the HTML page shows them"
        )
    target = project.products / PDF
    size = _write(target, pdf.content)
    return target, {"pdf_pages": pdf.pages, "pdf_size_kb": round(size / 1024)}


def _heights(site: Site, facts: Facts) -> Heights | None:
    """Heights of the ground over the footprints, as the map has them."""
    import cv2
    import numpy as np

    from georef_gis.measure.report.facts import Heights
    from georef_gis.model.terrain import FlatTerrain
    from georef_gis.model.tin import TinTerrain

    if isinstance(site.terrain, FlatTerrain):
        return None
    rings = {key: facts.local(f.ring_map) for key, f in facts.footprints.items()}
    far = np.vstack(list(rings.values())).max(axis=0)
    cell = max(float(far.max()) / RELIEF_CELLS, 1e-3)
    cols, rows = (max(2, int(np.ceil(v / cell))) for v in far)
    x, y = np.meshgrid((np.arange(cols) + 0.5) * cell, (rows - np.arange(rows) - 0.5) * cell)
    frame = site.frame
    level = np.full(x.shape, frame.origin.height_ellipsoidal)
    p_map = np.stack([x / facts.unit, y / facts.unit, level], axis=-1)
    p_map[..., :2] += facts.corner
    p_enu = frame.enu_from_map(p_map)
    p_enu[..., 2] = site.terrain.z_at(p_enu[..., :2])
    z = frame.map_from_enu(p_enu)[..., 2]
    seen = np.zeros(z.shape, dtype=np.uint8)
    for ring in rings.values():
        corners = np.round(np.stack([ring[:, 0] / cell, rows - ring[:, 1] / cell], axis=1))
        cv2.fillPoly(seen, [corners.astype(np.int32).reshape(-1, 1, 2)], 1)
    ground = site.terrain
    sigma = ground.sigma_at(p_enu[..., :2]) if isinstance(ground, TinTerrain) else None
    return Heights(z=z, seen=seen > 0, sigma=sigma, extent=(0.0, cols * cell, 0.0, rows * cell))


def _now() -> str:
    from datetime import UTC, datetime

    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")


def _versions() -> str:
    import platform
    from importlib.metadata import version

    import georef_gis

    parts = [f"georef_gis {georef_gis.__version__}", f"Python {platform.python_version()}"]
    parts += [f"{name} {version(name)}" for name in ("numpy", "scipy", "pyproj")]
    return ", ".join(parts)
