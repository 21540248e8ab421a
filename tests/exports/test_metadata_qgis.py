"""The .qmd beside a raster, as real QGIS reads it; and whose file it is."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from format_cases import HOSTILE, SYSTEM_PYTHON
from metadata_cases import (
    STATEMENT,
    across,
    make_project,
    read_xml,
    record,
    write_accuracy,
    write_metadata,
)

from exports.metadata.files import state_of

_READ = """
import json, os, sys
os.environ["QT_QPA_PLATFORM"] = "offscreen"
from qgis.core import QgsApplication, QgsRasterLayer
app = QgsApplication([], False)
app.initQgis()
layer = QgsRasterLayer(sys.argv[1], "x")
layer.loadDefaultMetadata()
m = layer.metadata()
box = m.extent().spatialExtents()[0]
said = {
    "title": m.title(), "abstract": m.abstract(), "identifier": m.identifier(),
    "licence": m.licenses(), "crs": m.crs().authid(), "history": m.history(),
    "contact": [[c.name, c.organization, c.email, c.role] for c in m.contacts()],
    "box": [box.bounds.xMinimum(), box.bounds.yMinimum(), box.bounds.xMaximum(),
            box.bounds.yMaximum()], "box_crs": box.extentCrs.authid(),
    "times": [t.toString("yyyy-MM-dd hh:mm:ss") for p in m.extent().temporalExtents()
              for t in (p.begin(), p.end())],
    "shown": "ONLY 6 checkpoints" in layer.htmlMetadata(),
}
print("SAID" + json.dumps(said), flush=True)
# QGIS may crash while it is taken down
os._exit(0)
"""


def qgis_reads(path: Path) -> dict[str, Any]:
    """What QGIS shows of a raster; skips without QGIS."""
    if subprocess.run([SYSTEM_PYTHON, "-c", "import qgis.core"], capture_output=True).returncode:
        pytest.skip("QGIS is not installed (apt install python3-qgis)")
    done = subprocess.run(
        [SYSTEM_PYTHON, "-c", _READ, str(path)], capture_output=True, text=True, check=True,
        cwd=path.parent, env={"PATH": "/usr/bin:/bin", "HOME": str(path.parent), "LANG": "C.UTF-8"},
    )  # fmt: skip
    return dict(json.loads(done.stdout.partition("SAID")[2]))


def test_qgis_shows_what_a_mosaic_is_and_how_accurate(tmp_path):
    who = {"organisation": HOSTILE[0], "contact": HOSTILE[1], "email": "a@b", "licence": HOSTILE[3]}
    project = make_project(tmp_path / "site", name=HOSTILE[4], metadata=who)
    write_accuracy(project)
    write_metadata(project)
    said = qgis_reads(project.products / "mosaic.tif")
    assert said["title"] == f"{HOSTILE[4]}: mosaic.tif"
    assert STATEMENT in said["abstract"]
    assert said["shown"]
    assert said["contact"] == [[HOSTILE[1], HOSTILE[0], "a@b", "pointOfContact"]]
    assert said["licence"] == [HOSTILE[3]]
    assert (said["crs"], said["box_crs"]) == ("EPSG:6549", "EPSG:4326")
    iso = read_xml(project.products / "mosaic.tif.xml")
    # deg: both are written with 9 decimals, and QGIS keeps what it reads
    sides = [
        float(iso.find(f".//{{*}}{side}").findtext("{*}Decimal"))
        for side in (
            "westBoundLongitude",
            "southBoundLatitude",
            "eastBoundLongitude",
            "northBoundLatitude",
        )
    ]
    assert said["box"] == pytest.approx(sides, abs=2e-9)
    assert said["times"] == ["2026-05-01 12:00:00", "2026-05-01 12:00:04"]
    assert any("mosaic" in line for line in said["history"])
    project.close()


def test_only_rasters_have_one_and_it_goes_with_them(tmp_path):
    project = make_project(tmp_path / "site")
    (project.products / "site.geojson").write_text("{}")
    record(project, "export_geojson", [project.products / "site.geojson"])
    path = project.products / "mosaic.qmd"
    write_metadata(project, standard="fgdc")
    assert not path.exists()
    write_metadata(project)
    assert [p.name for p in project.products.glob("*.qmd")] == ["mosaic.qmd"]
    write_metadata(project, standard="fgdc")
    assert path.exists()
    (project.products / "mosaic.tif").unlink()
    write_metadata(project)
    assert not path.exists()
    project.close()


def test_file_that_qgis_saved_is_left_and_told(tmp_path):
    project = make_project(tmp_path / "site")
    path = project.products / "mosaic.qmd"
    path.write_text("<qgis version='3.22.0'><title>my own</title></qgis>")
    _, feedback = write_metadata(project)
    assert state_of(path) == "foreign"
    assert "mosaic.qmd: is not of georef" in " ".join(feedback.warnings)
    path.write_text("<qgis version='3.22.0'><abstract>by georef_gis, edited</abstract></qgis>")
    write_metadata(project)
    assert state_of(path) == "edited"
    project.close()


def test_box_across_the_antimeridian_is_left_out(tmp_path):
    site = across(tmp_path / "site")
    project = make_project(tmp_path / "site", site=site)
    write_metadata(project)
    root = read_xml(project.products / "mosaic.qmd")
    assert root.find("extent/spatial") is None
    assert root.findtext("title") == "Site & <road>: mosaic.tif"
    project.close()
