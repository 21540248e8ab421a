"""Tool `report`: one page that shows what was made and how good it is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.measure.report.facts import Facts, Heights
    from processing_algorithms.site import Site

REPORT = "report.html"
# cells along the longer side of the picture of the relief
RELIEF_CELLS = 420


class Report(Algorithm[p.Parameters]):
    """One HTML page of the project: map, overlap, ties, residuals, camera, ground, accuracy.

    The page needs no network and no other file, and prints. Each figure says what to look for and
    what was found; what asks for a look stands at the top.
    """

    id, name, group = "report", "Report page", "measure"
    outputs = (Output(name="report", title="Report page"),)
    needs, gives = ("footprints",), ("report",)
    wants = ("adjusted", "mosaic", "orthos", "control", "accuracy")
    in_run = True
    uses_quick = True
    uses_settings = ("project", "ground")

    def inputs(self, context: Context, parameters: p.Parameters) -> Sequence[Path]:
        """What the adjustment and the products left as files."""
        project = context.require_project()
        names = ("report.json", "residuals.npz", "points.npz", "matches.json", "surface.npz")
        files = [project.adjustment / name for name in names] if not context.quick else []
        files += [project.products / n for n in ("overlap.tif", "mosaic.tif", "accuracy.json")]
        return [path for path in files if path.is_file()]

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        """Read, draw, write."""
        from georef_gis.measure.report.build import report_page, report_sections
        from georef_gis.measure.report.facts import read_facts
        from georef_gis.measure.report.page import count_verdicts
        from georef_gis.rasters.files import export_errors, whole_file
        from processing_algorithms.site import load_site

        project = context.require_project()
        facts = read_facts(project, quick=context.quick)
        for line in facts.missing:
            feedback.warn(line)
        heights = _heights(load_site(project, quick=context.quick), facts)

        def told(share: float, what: str) -> None:
            check_cancelled(feedback)
            feedback.progress(0.1 + 0.85 * share, what)

        sections = report_sections(facts, heights, told)
        page = report_page(facts, sections, made=_now(), versions=_versions())
        content = page.encode("utf-8")
        target = project.products / REPORT
        with export_errors(target, lambda: len(content)), whole_file(target) as stream:
            stream.write(content)
        summary: dict[str, Any] = {"products": [str(target)], **count_verdicts(sections)}
        summary["size_kb"] = round(len(content) / 1024)
        return Result(outputs={"report": target}, summary=summary)


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
