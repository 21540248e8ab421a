"""ISO 19139 and FGDC files: valid, read by OWSLib, never of an older state without saying so."""

from __future__ import annotations

import hashlib
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from format_cases import HOSTILE
from metadata_cases import (
    NS,
    STATEMENT,
    across,
    check_metadata,
    fgdc_schema,
    iso_schema,
    make_project,
    read_xml,
    record,
    texts,
    write_accuracy,
    write_metadata,
)
from owslib.iso import MD_Metadata
from site_cases import make_frame, make_site

from exports import EXPORTERS
from exports.metadata.metadata import Metadata
from exports.metadata.products import FOLDERS
from georef_gis.errors import ExportError
from georef_gis.geodesy import parse_crs
from georef_gis.project import Project
from georef_gis.toolbox import Context, Sender

WHO = {"organisation": "DOT & Söhne <GIS>", "contact": "=cmd|'/c calc'!A0",
       "email": "a@example.org", "licence": "CC-BY-4.0"}  # fmt: skip
# Order of what the standards ask for or allow; read from their texts, not from our writer.
ISO_ORDER = {
    "MD_Metadata": "fileIdentifier language characterSet parentIdentifier hierarchyLevel "
    "hierarchyLevelName contact dateStamp metadataStandardName metadataStandardVersion dataSetURI "
    "locale spatialRepresentationInfo referenceSystemInfo metadataExtensionInfo "
    "identificationInfo contentInfo distributionInfo dataQualityInfo",
    "MD_DataIdentification": "citation abstract purpose credit status pointOfContact "
    "resourceMaintenance graphicOverview resourceFormat descriptiveKeywords "
    "resourceSpecificUsage resourceConstraints aggregationInfo spatialRepresentationType "
    "spatialResolution language characterSet topicCategory environmentDescription extent "
    "supplementalInformation",
    "CI_Citation": "title alternateTitle date edition editionDate identifier",
    "DQ_DataQuality": "scope report lineage",
    "DQ_AbsoluteExternalPositionalAccuracy": "nameOfMeasure measureIdentification "
    "measureDescription evaluationMethodType evaluationMethodDescription evaluationProcedure "
    "dateTime result",
    "LI_ProcessStep": "description rationale dateTime processor source",
    "EX_GeographicBoundingBox": "extentTypeCode westBoundLongitude eastBoundLongitude "
    "southBoundLatitude northBoundLatitude",
}
FGDC_ORDER = {
    "metadata": "idinfo! dataqual spdoinfo spref eainfo distinfo metainfo!",
    "idinfo": "citation! descript! timeperd! status! spdom! keywords! accconst! useconst!",
    "citeinfo": "origin! pubdate! pubtime title! edition geoform",
    "descript": "abstract! purpose! supplinf",
    "timeperd": "timeinfo! current!",
    "status": "progress! update!",
    "bounding": "westbc! eastbc! northbc! southbc!",
    "theme": "themekt! themekey!",
    "dataqual": "attracc logic! complete! posacc lineage!",
    "posacc": "horizpa vertacc",
    "horizpa": "horizpar! qhorizpa",
    "qhorizpa": "horizpav! horizpae!",
    "vertacc": "vertaccr! qvertpa",
    "qvertpa": "vertaccv! vertacce!",
    "procstep": "procdesc! srcused procdate! proctime",
    "spdoinfo": "indspref direct! ptvctinf rastinfo",
    "rastinfo": "rasttype! rowcount colcount",
    "planar": "mapproj gridsys localp planci!",
    "gridsys": "gridsysn! utm ups spcs arcsys othergrd",
    "planci": "plance! coordrep distbrep plandu!",
    "coordrep": "absres! ordres!",
    "distinfo": "distrib! resdesc distliab!",
    "metainfo": "metd! metrd metfrd metc! metstdn! metstdv!",
    "cntinfo": "cntperp cntorgp cntpos cntaddr! cntvoice! cnttdd cntfax cntemail",
    "cntaddr": "addrtype! address city! state! postal! country",
}


@pytest.fixture
def project(tmp_path: Path) -> Any:
    """The site with its mosaic, and who made it."""
    project = make_project(tmp_path / "site", metadata=WHO)
    yield project
    project.close()


def export_csv(project: Project, name: str = "poses.csv") -> Path:
    path = project.products / name
    path.write_text("x,y\n1,2\n")
    record(project, "export_poses_csv", [path], summary={
        "crs": "EPSG:6549", "height_kind": "ellipsoidal", "features": 1,
    })  # fmt: skip
    return path


def out_of_order(root: Any, orders: dict[str, str], *, strict: bool) -> list[str]:
    """Elements that stand where they must not, and with `strict` those that lack."""
    wrong = []
    for parent in root.iter():
        if not isinstance(parent.tag, str):
            continue
        name = parent.tag.rpartition("}")[2]
        if name not in orders:
            continue
        names = [word.rstrip("!") for word in orders[name].split()]
        found = [child.tag.rpartition("}")[2] for child in parent if isinstance(child.tag, str)]
        wrong += [f"{name}/{one} is unknown" for one in found if one not in names]
        places = [names.index(one) for one in found if one in names]
        if places != sorted(places):
            wrong.append(f"{name}: {found}")
        must = [word.rstrip("!") for word in orders[name].split() if word.endswith("!")]
        wrong += [f"{name} lacks {one}" for one in must if strict and one not in found]
    return wrong


# -- what is said ------------------------------------------------------------------------------


def test_owslib_reads_what_project_and_records_say(project):
    write_accuracy(project)
    write_metadata(project)
    path = project.products / "mosaic.tif.xml"
    read = MD_Metadata(read_xml(path))
    about = read.identification[0]
    assert about.title == "Site & <road>: mosaic.tif"
    assert read.contact[0].organization == WHO["organisation"]
    assert read.contact[0].name == WHO["contact"]
    assert read.contact[0].email == WHO["email"]
    assert about.otherconstraints == [WHO["licence"]]
    # one pixel of 5 cm, in m whatever the unit of the CRS
    assert [float(d) for d in about.distance] == pytest.approx([0.05], abs=1e-6)
    assert about.temporalextent_start == "2026-05-01T12:00:00Z"
    assert about.temporalextent_end == "2026-05-01T12:00:04Z"
    assert read.referencesystem.code == "6549"
    box = about.bbox
    sides = [float(v) for v in (box.minx, box.miny, box.maxx, box.maxy)]
    # the mosaic is 35 m x 25 m at 83 W, 40 N
    assert sides == pytest.approx([-83.0, 40.0, -83.0, 40.0], abs=1e-3)
    assert sides[0] < sides[2]
    assert sides[1] < sides[3]
    assert "Photos: 3. Poses: tags." in read.dataquality.lineage


def test_accuracy_stands_in_metres_with_its_points_and_words(project):
    write_accuracy(project, declared=True)
    write_metadata(project)
    root = read_xml(project.products / "mosaic.tif.xml")
    reports = root.findall(".//gmd:DQ_AbsoluteExternalPositionalAccuracy", NS)
    values = [texts(report, ".//gco:Record") for report in reports]
    # tested across and up, then what the footprints expect
    assert values == [["0.0419"], ["0.0894"], ["2.5"]]
    units = {unit.get(f"{{{NS['xlink']}}}href") for unit in root.iterfind(".//gmd:valueUnit", NS)}
    assert units == {"http://www.opengis.net/def/uom/EPSG/0/9001"}
    told = texts(reports[0], "gmd:evaluationMethodDescription")[0]
    assert told == f"6 check points, measured on horizontal: mosaic.tif. {STATEMENT}"
    assert texts(root, ".//gmd:pass") == ["true", "true"]


def test_untested_accuracy_has_no_figure(project):
    write_metadata(project)
    root = read_xml(project.products / "mosaic.tif.xml")
    first = root.find(".//gmd:DQ_AbsoluteExternalPositionalAccuracy", NS)
    assert texts(first, "gmd:evaluationMethodDescription") == ["The accuracy was not tested."]
    assert first.find("gmd:result", NS).get(f"{{{NS['gco']}}}nilReason") == "unknown"


def test_lineage_holds_each_step_with_its_parameters_and_versions(project):
    write_metadata(project)
    root = read_xml(project.products / "mosaic.tif.xml")
    steps = texts(root, ".//gmd:LI_ProcessStep/gmd:description")
    tools = [step.partition(" ")[0] for step in steps]
    names = ("read_photos", "orient_direct", "footprints", "mosaic")
    assert tools == [f"georef:{name}" for name in names]
    assert "georef-gis 0.1.0, tool 3" in steps[1]
    assert "'); DROP TABLE run; --" in steps[1]


def test_empty_settings_are_said_to_be_unknown(tmp_path):
    project = make_project(tmp_path / "site")
    write_metadata(project)
    root = read_xml(project.products / "mosaic.tif.xml")
    for tag in ("organisationName", "otherConstraints"):
        found = root.findall(f".//gmd:{tag}", NS)
        assert found
        assert {one.get(f"{{{NS['gco']}}}nilReason") for one in found} == {"unknown"}
    project.close()


def test_checksum_is_that_of_sha256sum(project):
    write_metadata(project)
    mosaic = project.products / "mosaic.tif"
    said = texts(read_xml(Path(f"{mosaic}.xml")), ".//gmd:MD_Identifier/gmd:code")
    tool = subprocess.run(["sha256sum", str(mosaic)], capture_output=True, text=True, check=True)
    assert said == [f"sha256:{tool.stdout.split()[0]}"]


def test_system_without_a_code_is_told_by_its_wkt(tmp_path):
    crs = make_frame("EPSG:32617").crs.to_json_dict()
    crs.pop("id")
    crs["name"] = "county <system>"
    crs["conversion"]["parameters"][2]["value"] = 1.00002
    from georef_gis.geodesy import CRS

    wkt = CRS.from_json_dict(crs).to_wkt()
    project = make_project(tmp_path / "site", crs=wkt)
    write_metadata(project)
    root = read_xml(project.products / "mosaic.tif.xml")
    codes = texts(root, ".//gmd:RS_Identifier/gmd:code")
    assert len(codes) == 1
    assert parse_crs(codes[0]).equals(parse_crs(wkt))
    assert texts(root, ".//gmd:RS_Identifier/gmd:codeSpace") == ["WKT2:2019"]
    project.close()


# -- validity ----------------------------------------------------------------------------------


def hostile_project(tmp_path: Path, name: str) -> Project:
    who = {"organisation": name, "contact": name, "licence": name}
    return make_project(tmp_path / "site", name=name, metadata=who)


@pytest.mark.parametrize("name", [*HOSTILE, "nul\x00, bell\x07 and \ufffe", "<!-- -->]]>"])
def test_hostile_names_survive_in_both_standards(tmp_path, name):
    project = hostile_project(tmp_path, name)
    write_metadata(project, standard="both")
    xml_name = "".join(c if c in "\t\n\r" or (c >= " " and c != "\ufffe") else "�" for c in name)
    # XML readers make one line feed of a carriage return and a line feed
    wanted = xml_name.replace("\r\n", "\n").strip()
    iso = read_xml(project.products / "mosaic.tif.xml")
    assert set(texts(iso, ".//gmd:organisationName")) == {wanted}
    assert out_of_order(iso, ISO_ORDER, strict=False) == []
    fgdc = read_xml(project.products / "mosaic.tif.fgdc.xml")
    assert set(texts(fgdc, ".//cntorg")) == {wanted}
    assert out_of_order(fgdc, FGDC_ORDER, strict=True) == []
    project.close()


def test_iso_files_are_valid_against_the_published_schema(tmp_path):
    schema = iso_schema()
    who = {"organisation": HOSTILE[0], "contact": HOSTILE[1], "email": "x", "licence": HOSTILE[3]}
    project = make_project(tmp_path / "site", name=HOSTILE[2], metadata=who)
    write_accuracy(project, declared=True)
    export_csv(project, "=cmd & 'x' ü🚧.csv")
    (project.products / "orthos").mkdir()
    (project.products / "orthos" / "a.tif").write_bytes(b"no raster")
    record(project, "orthos", [project.products / "orthos"])
    write_metadata(project)
    files = sorted(project.products.glob("*.xml"))
    assert len(files) == 3
    for path in files:
        assert schema.validate(read_xml(path)), (path.name, schema.error_log)
    project.close()


def test_fgdc_files_are_valid_against_the_published_schema(project):
    schema = fgdc_schema()
    export_csv(project, "=cmd & 'x' ü🚧.csv")
    export_of_each_kind(project)
    write_metadata(project, standard="fgdc")
    files = sorted(project.products.glob("*.fgdc.xml"))
    assert len(files) == 5
    for path in files:
        assert schema.validate(read_xml(path)), (path.name, schema.error_log)


def export_of_each_kind(project: Project) -> None:
    """Tiles, whose pixels no record tells; features; and a folder of files."""
    for tool, name in (("export_mbtiles", "m.mbtiles"), ("export_geojson", "photos.geojson")):
        (project.products / name).write_bytes(b"something")
        record(project, tool, [project.products / name], summary={"crs": "EPSG:3857"})
    (project.products / "site_shp").mkdir()
    (project.products / "site_shp" / "photos.shp").write_bytes(b"something")
    record(project, "export_shapefile", [project.products / "site_shp"])


def test_resolution_of_fgdc_is_a_length_for_every_kind_of_product(project):
    """The standard has no `Unknown` there, so the nominal spacing of coordinates stands in it."""
    export_of_each_kind(project)
    write_metadata(project, standard="fgdc")
    roots = {path.name: read_xml(path) for path in project.products.glob("*.fgdc.xml")}
    found = {
        name.removesuffix(".fgdc.xml"): [
            float(text) for tag in ("absres", "ordres") for text in texts(root, f".//{tag}")
        ]
        for name, root in roots.items()
    }
    # m: pixel of the mosaic, GSD of the mosaic the tiles are made of, 0.1 mm of vertices
    assert found == {
        "mosaic.tif": [pytest.approx(0.05, rel=1e-3)] * 2, "m.mbtiles": [0.05] * 2,
        "photos.geojson": [1e-4] * 2, "site_shp": [1e-4] * 2,
    }  # fmt: skip


def test_fgdc_without_a_spacing_leaves_the_reference_out_and_names_the_crs(project):
    for row in project.database.rows("run"):
        project.database.update("run", row["fid"], summary={})
    export_of_each_kind(project)
    write_metadata(project, standard="fgdc")
    root = read_xml(project.products / "m.mbtiles.fgdc.xml")
    assert texts(root, ".//absres") == []
    assert "EPSG:3857" in texts(root, ".//supplinf")[0]
    assert out_of_order(root, FGDC_ORDER, strict=True) == []


def test_folders_of_all_exporters_of_features_and_tiles_are_products():
    folders = {f"export_{e.id}" for e in EXPORTERS if not e.suffix and not issubclass(e, Sender)}
    # what only other programs read as a whole, and says itself what it is
    assert folders - set(FOLDERS) == {"export_colmap", "export_stac"}


def test_fgdc_holds_the_same_figures(project):
    write_accuracy(project)
    write_metadata(project, standard="fgdc")
    root = read_xml(project.products / "mosaic.tif.fgdc.xml")
    assert texts(root, ".//horizpav") == ["0.0419"]
    assert texts(root, ".//vertaccv") == ["0.0894"]
    assert texts(root, ".//horizpar") == [
        f"6 check points, measured on horizontal: mosaic.tif. {STATEMENT}"
    ]
    assert [texts(root, f".//{tag}") for tag in ("begdate", "enddate")] == [["20260501"]] * 2
    assert float(texts(root, ".//westbc")[0]) == pytest.approx(-83.0, abs=1e-3)
    assert not (project.products / "mosaic.tif.xml").exists()


def test_site_across_the_antimeridian_has_its_west_east_of_its_east(tmp_path):
    folder = tmp_path / "site"
    site = across(folder)
    project = make_project(folder, site=site)
    write_metadata(project)
    root = read_xml(project.products / "mosaic.tif.xml")
    west, east = (
        float(texts(root, f".//gmd:{side}BoundLongitude")[0]) for side in ("west", "east")
    )
    assert 179.99 < west < 180.0
    assert -180.0 < east < -179.99
    project.close()


def test_photos_without_times_leave_the_period_open(tmp_path):
    folder = tmp_path / "site"
    plain = make_site(folder)
    photos = tuple(replace(p, photo=replace(p.photo, time_gps=None)) for p in plain.photos)
    project = make_project(folder, site=replace(plain, photos=photos))
    write_metadata(project)
    root = read_xml(project.products / "mosaic.tif.xml")
    begin = root.find(".//gml:beginPosition", NS)
    assert begin.get("indeterminatePosition") == "unknown"
    assert not begin.text
    assert "not known in UTC" in texts(root, ".//gmd:abstract")[0]
    project.close()


# -- staleness ---------------------------------------------------------------------------------


def test_check_tells_a_product_that_was_made_again(project):
    write_metadata(project)
    check_metadata(project)
    mosaic = project.products / "mosaic.tif"
    data = bytearray(mosaic.read_bytes())
    data[-1] ^= 1
    mosaic.write_bytes(data)
    with pytest.raises(ExportError, match=r"mosaic\.tif\.xml is of an older state") as caught:
        check_metadata(project)
    assert "\n" not in str(caught.value)
    write_metadata(project)
    check_metadata(project)
    root = read_xml(project.products / "mosaic.tif.xml")
    digest = hashlib.sha256(mosaic.read_bytes()).hexdigest()
    assert texts(root, ".//gmd:MD_Identifier/gmd:code") == [f"sha256:{digest}"]
    assert "changed by another program" in texts(root, ".//gmd:useLimitation")[0]


def test_check_tells_missing_metadata(project):
    with pytest.raises(ExportError, match=r"mosaic\.tif\.xml is missing"):
        check_metadata(project)


def test_products_are_inputs_so_that_a_new_one_makes_the_step_stale(project):
    parameters = Metadata.Parameters()
    mosaic = project.products / "mosaic.tif"
    assert Metadata().inputs(Context(project=project), parameters) == [mosaic]
    path = export_csv(project)
    assert Metadata().inputs(Context(project=project), parameters) == [mosaic, path]


def test_accuracy_is_not_claimed_for_a_product_of_older_poses(project):
    path = export_csv(project)
    record(project, "adjust")
    mosaic = project.products / "mosaic.tif"
    record(project, "mosaic", [mosaic])
    write_accuracy(project)
    _, feedback = write_metadata(project)
    old, new = read_xml(Path(f"{path}.xml")), read_xml(Path(f"{mosaic}.xml"))
    assert texts(new, ".//gco:Record")[:1] == ["0.0419"]
    assert texts(old, ".//gco:Record") == []
    assert "made before the poses" in texts(old, ".//gmd:useLimitation")[0]
    assert "georef:adjust" not in " ".join(texts(old, ".//gmd:LI_ProcessStep"))
    assert [w for w in feedback.warnings if w.startswith("poses.csv: older than the poses")]


def test_accuracy_of_an_older_mosaic_is_left_out(project):
    write_accuracy(project)
    record(project, "mosaic", [project.products / "mosaic.tif"])
    _, feedback = write_metadata(project)
    root = read_xml(project.products / "mosaic.tif.xml")
    assert texts(root, ".//gco:Record") == ["2.5"]
    assert any("is of an older mosaic" in w for w in feedback.warnings)


def test_metadata_of_a_deleted_product_go_with_it(project):
    path = export_csv(project)
    write_metadata(project, standard="both")
    assert Path(f"{path}.xml").is_file()
    path.unlink()
    _, feedback = write_metadata(project, standard="both")
    assert not list(project.products.glob("poses.csv*"))
    assert "poses.csv.xml: removed, for what it was of is gone" in feedback.infos


def test_same_products_give_the_same_identifier(project):
    write_metadata(project)
    path = project.products / "mosaic.tif.xml"
    first = texts(read_xml(path), "gmd:fileIdentifier")
    record(project, "mosaic", [project.products / "mosaic.tif"])
    write_metadata(project)
    assert texts(read_xml(path), "gmd:fileIdentifier") == first


# -- what lies in the way ----------------------------------------------------------------------


def test_files_of_others_and_edited_ones_are_left_and_told(project):
    path = project.products / "mosaic.tif.xml"
    path.write_text("<metadata><Esri/></metadata>")
    _, feedback = write_metadata(project)
    assert path.read_text() == "<metadata><Esri/></metadata>"
    assert any("is not of georef and is left" in w for w in feedback.warnings)
    path.unlink()
    write_metadata(project)
    edited = path.read_text().replace("Site &amp; &lt;road&gt;", "Other name")
    path.write_text(edited)
    _, feedback = write_metadata(project)
    assert path.read_text() == edited
    assert any("was changed by hand" in w for w in feedback.warnings)


def test_half_written_file_is_written_anew(project):
    write_metadata(project)
    path = project.products / "mosaic.tif.xml"
    path.write_bytes(path.read_bytes()[:2000])
    _, feedback = write_metadata(project)
    assert feedback.warnings == []
    check_metadata(project)


def test_folder_in_the_way_is_told_and_the_others_are_written(project):
    path = export_csv(project)
    (project.products / "mosaic.tif.xml").mkdir()
    _, feedback = write_metadata(project)
    assert Path(f"{path}.xml").is_file()
    assert any("is a folder" in w for w in feedback.warnings)


def test_product_whose_name_leaves_no_room_is_told_and_the_others_are_written(project):
    # 255 bytes are what a disk takes: the first just fits, the second does not
    for stem in ("a" * 247, "b" * 250):
        export_csv(project, f"{stem}.csv")
    _, feedback = write_metadata(project)
    names = {path.name[0] for path in project.products.glob("*.xml")}
    assert names == {"a", "m"}
    assert [w[0] for w in feedback.warnings] == ["b"]
    assert "is too long a name" in feedback.warnings[0]


def test_unwritable_target_is_one_line_with_a_cure(project, monkeypatch):
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("exports.metadata.files.os.replace", refuse)
    with pytest.raises(ExportError, match=r"cannot be written.*check free space and permission"):
        write_metadata(project)
    assert not list(project.products.glob("*.xml"))
    assert not list(project.products.glob(".*.part"))


def test_tools_are_taken_in_and_the_metadata_come_last(project):
    from exports import TOOLS
    from georef_gis.toolbox.pipeline import plan_steps
    from georef_gis.toolbox.registry import Registry

    registry = Registry()
    registry.add("georef", TOOLS, "georef-gis", "0.1")
    assert registry.refused == []
    assert registry.find("check-metadata").algorithm.in_run is False
    steps = [tool.id for tool in plan_steps(registry)]
    assert {"export_kmz", "export_geopackage"} < set(steps)
    assert steps[-1] == "export_metadata"


def test_project_without_products_writes_nothing(tmp_path):
    project = make_project(tmp_path / "site")
    (project.products / "mosaic.tif").unlink()
    result, _ = write_metadata(project)
    assert result.summary == {"files": 0, "of": 0}
    project.close()
