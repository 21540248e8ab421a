"""A project with run records and products, and readers of metadata that share nothing with us."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from lxml import etree
from site_cases import make_site, write_mosaic, write_photos

from exports.metadata.metadata import CheckMetadata, Metadata
from exports.site.site import SiteLayers
from georef_gis.geodesy import MapFrame, Origin, parse_crs
from georef_gis.project import Project
from georef_gis.project.records import (
    camera_row,
    footprint_row,
    photo_row,
    pose_row,
    save_frame,
)
from georef_gis.toolbox import CollectingFeedback, Context, Result
from georef_gis.toolbox.staleness import output_fingerprints

STATEMENT = "Tested 0.042 m RMSE_H <horizontal> & so on at ONLY 6 checkpoints."
NS = {
    "gmd": "http://www.isotc211.org/2005/gmd",
    "gco": "http://www.isotc211.org/2005/gco",
    "gml": "http://www.opengis.net/gml/3.2",
    "xlink": "http://www.w3.org/1999/xlink",
}
# The tests that ask for it are skipped where the schemas of ISO 19139 are not at hand.
SCHEMAS, FGDC_SCHEMAS = "GEOREF_ISO_XSD", "GEOREF_FGDC_XSD"
# Where an unpacked wheel of pycsw has those of ISO 19139
_PYCSW = "pycsw/plugins/profiles/apiso/schemas/ogc"
_XLINK = """<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema"
 xmlns="http://www.w3.org/1999/xlink" targetNamespace="http://www.w3.org/1999/xlink">{}
<xs:attributeGroup name="simpleAttrs">{}</xs:attributeGroup></xs:schema>"""
_XLINK_NAMES = ("type", "href", "role", "arcrole", "title", "show", "actuate")


def make_project(
    folder: Path,
    *,
    name: str = "Site & <road>",
    crs: str = "EPSG:6549",
    metadata: Mapping[str, str] | None = None,
    site: SiteLayers | None = None,
) -> Project:
    """The site of three photos in a database, with its mosaic and the runs that made it."""
    folder.mkdir()
    write_photos(folder)
    values = {"project": {"name": name}, "metadata": dict(metadata or {})}
    project = Project.create(folder, values)
    project.prepare()
    site = site or make_site(folder, crs=crs)
    fill(project, site)
    mosaic = project.products / "mosaic.tif"
    write_mosaic(mosaic, site.frame, width=700, height=500)
    record(project, "read_photos", summary={"photos": len(site.photos)})
    record(project, "orient_direct", parameters={"note": 'a & <b> "c" \'); DROP TABLE run; --'})
    record(project, "footprints", summary={"sigma_horizontal_m": 2.5, "gsd_m": 0.05})
    record(project, "mosaic", [mosaic], summary={"gsd_m": 0.05, "products": [str(mosaic)]})
    return project


def across(folder: Path) -> SiteLayers:
    """The site of three photos, 10 m west of the antimeridian."""
    plain = make_site(folder)
    origin = Origin(lat=-0.3, lon=3.1415926535 - 1.5e-6, height_ellipsoidal=200.0)
    frame = MapFrame(origin, parse_crs("EPSG:32760"))
    prints = tuple(
        replace(f, ring_map=frame.map_from_enu(f.ring_enu)[:, :2]) for f in plain.footprints
    )
    return replace(plain, frame=frame, footprints=prints)


def fill(project: Project, site: SiteLayers) -> None:
    """Rows of a site."""
    rows = [photo_row(p.photo, site.frame, status="ok", fingerprint="") for p in site.photos]
    poses = [
        pose_row(p.photo.id, p.pose, site.frame, height_above_ground=100.0, dialect="ypr",
                 doubts=p.photo.doubts)
        for p in site.photos if p.pose is not None
    ]  # fmt: skip
    prints = [footprint_row(f, pose_kind="tags", doubts=()) for f in site.footprints]
    database = project.database
    with database.transaction():
        save_frame(database, site.frame)
        database.set_meta(epoch=site.epoch_gps)
        database.replace_rows("photo", rows)
        database.replace_rows("pose", poses)
        database.replace_rows("camera", [camera_row(c) for c in site.cameras])
        database.replace_rows("footprint", prints)


def record(
    project: Project,
    tool: str,
    outputs: Sequence[Path] = (),
    *,
    summary: Mapping[str, Any] | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> int:
    """Record of a run that was done, an hour after the one before it."""
    count = project.database.count("run")
    started = datetime(2026, 5, 2, 8, tzinfo=UTC) + timedelta(hours=count)
    return project.database.insert("run", {
        "tool": f"georef:{tool}", "outcome": "done", "duration_s": 60.0,
        "started": started.isoformat(" ", "milliseconds"), "parameters": dict(parameters or {}),
        "settings": {}, "versions": {"tool": "3", "georef-gis": "0.1.0"}, "quick": 0,
        "upstream": {}, "inputs": {}, "outputs": output_fingerprints(outputs, project),
        "summary": dict(summary or {}), "warnings": [], "process": 1,
    })  # fmt: skip


def write_accuracy(project: Project, *, declared: bool = False) -> Path:
    """A statement with 6 check points, recorded as that of the tool `accuracy`."""
    shared = {"n": 6, "vegetated": False, "class_declared": declared, "statement": STATEMENT,
              "meets": True if declared else None}  # fmt: skip
    axis = {"n": 6, "mean": -0.0165, "sd": 0.0251, "rmse": 0.0283}
    data = {
        "format": "georef_gis accuracy 1", "standard": "ASPRS & co", "statement": [STATEMENT],
        "assessments": {"products": {
            "measured_on": {"horizontal": "mosaic.tif"}, "flags": [], "residuals": [],
            "axes": {"x": axis, "y": {**axis, "mean": 0.01}, "z": axis},
            "components": [
                {**shared, "name": "H", "rmse": 0.0419, "class_m": 0.042},
                {**shared, "name": "V", "rmse": 0.0894, "class_m": 0.0895},
            ],
        }},
        "survey": {"datum": "NAD83(2011)", "product_datum": "unknown", "flags": []},
    }  # fmt: skip
    path = project.products / "accuracy.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    record(project, "accuracy", [path])
    return path


def write_metadata(project: Project, **values: Any) -> tuple[Result, CollectingFeedback]:
    """Run the tool."""
    feedback = CollectingFeedback()
    parameters = Metadata.Parameters(**values)
    return Metadata().run(Context(project=project), parameters, feedback), feedback


def check_metadata(project: Project, **values: Any) -> Result:
    """Run the tool that compares checksums."""
    parameters = CheckMetadata.Parameters(**values)
    return CheckMetadata().run(Context(project=project), parameters, CollectingFeedback())


def read_xml(path: Path) -> Any:
    """Root of a file."""
    return etree.parse(str(path)).getroot()


def texts(root: Any, path: str) -> list[str]:
    """Texts of the elements of a path, white space at the ends cut off."""
    return ["".join(found.itertext()).strip() for found in root.iterfind(path, NS)]


def iso_schema() -> Any:
    """Schema of ISO 19139 (gmd 20070417) as the OGC publishes it; skips where it is not."""
    given = os.environ.get(SCHEMAS)
    if not given:
        pytest.skip(f"no schemas of ISO 19139 at hand: {SCHEMAS} names no folder")
    base = Path(given)
    attributes = "".join(f'<xs:attribute name="{n}" type="xs:string"/>' for n in _XLINK_NAMES)
    references = "".join(f'<xs:attribute ref="{n}"/>' for n in _XLINK_NAMES)
    xlink = _XLINK.format(attributes, references)

    class Local(etree.Resolver):
        def resolve(self, url: str, public: str, context: Any) -> Any:
            if url.endswith("/xlink.xsd"):
                return self.resolve_string(xlink, context)
            if url.startswith("http://schemas.opengis.net/"):
                local = base / url.removeprefix("http://schemas.opengis.net/")
                return self.resolve_filename(str(local), context)
            return None

    parser = etree.XMLParser()
    parser.resolvers.add(Local())
    if (base / _PYCSW).is_dir():
        base /= _PYCSW
    main = base / "iso" / "19139" / "20070417" / "gmd" / "gmd.xsd"
    return etree.XMLSchema(etree.parse(str(main), parser))


def fgdc_schema() -> Any:
    """Schema of FGDC-STD-001-1998; skips where it is not at hand."""
    given = os.environ.get(FGDC_SCHEMAS)
    if not given:
        pytest.skip(f"no schema of FGDC-STD-001-1998 at hand: {FGDC_SCHEMAS} names no folder")
    return etree.XMLSchema(etree.parse(str(Path(given) / "fgdc-std-001-1998.xsd")))
