"""``work_zone.toml`` of a project: found, or written to be filled in."""

from __future__ import annotations

import uuid
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from georef_gis.toolbox import Result

if TYPE_CHECKING:
    from georef_gis.project import Project
    from georef_gis.toolbox import Feedback


def zone_path(project: Project, given: Path | None) -> Path:
    """File that a zone's settings stand in, or will."""
    from georef_gis.measure.workzone.zone_settings import ZONE_FILE

    return given or project.folder / ZONE_FILE


def write_zone_file(project: Project, path: Path, feedback: Feedback) -> Result:
    """Write a file to fill in, with the lines and edges there are, and say what comes next."""
    from georef_gis.measure.assets.store import AssetStore
    from georef_gis.measure.workzone.zone_settings import zone_template
    from georef_gis.rasters.files import export_errors, resolve_target, whole_file
    from processing_algorithms.assets.zone_input import DEVICES, SIGNS, line_of

    with AssetStore.of_project(project) as store:
        assets, domain = store.assets(), store.domain
    devices, signs = (
        Counter(line_of(a) for a in assets if a.kind in domain.in_group(group) and line_of(a))
        for group in (DEVICES, SIGNS)
    )
    edges = [asset.name for asset in assets if asset.shape == "line" and asset.name]
    text = zone_template(
        event_id=str(uuid.uuid4()), devices=devices, signs=signs, edges=edges
    ).encode()
    with export_errors(path, lambda: len(text)), whole_file(resolve_target(path)) as stream:
        stream.write(text)
    if not devices:
        feedback.warn(
            "no device of the project belongs to a line yet: click cones or drums with the "
            "attribute `line` (`georef assets --clicks`)"
        )
    told = f"fill in {path.name}, then run this again; nothing was looked at yet"
    return Result(outputs={"zone": path}, summary={"next": told})
