"""Heights of products in the unit and above the geoid that the project's CRS promises."""

from __future__ import annotations

import math
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
import shapely
from grid_cases import plane, write_tiff

from exports.site.site import SiteLayers
from exports.site.values import SiteControl
from exports.tables.dxf import Dxf, DxfOptions
from georef_gis.errors import CrsError
from georef_gis.geodesy import CRS, Datum, MapFrame, Origin, map_crs, vertical_part
from georef_gis.measure.surface.field import GroundField
from georef_gis.measure.surface.raster import HeightReference, surface_profile, surface_tiles
from georef_gis.model.grid import Grid
from georef_gis.model.terrain import FlatTerrain
from georef_gis.project import Project
from georef_gis.project.asset_layers import AssetTable
from georef_gis.rasters.writer import TiledWriter
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT
from processing_algorithms.surface.given import raster_field
from processing_algorithms.surface.las_files import CellFile

GEOID18 = "us_noaa_g2018u0.tif"
LAT, LON = 40.1, -82.9
LEVEL, SIGMA = 250.0, 0.1
ORIGIN = Origin(lat=math.radians(LAT), lon=math.radians(LON), height_ellipsoidal=LEVEL)


@pytest.fixture
def ground() -> GroundField:
    return GroundField.of(
        FlatTerrain(origin=ORIGIN, height_ellipsoidal=LEVEL, sigma=SIGMA), "flat", level=0.0
    )


def written(path: Path, crs: str, ground: GroundField) -> tuple[Path, Path]:
    """Surface about the origin as GeoTIFF and as LAS in a project's CRS."""
    frame = MapFrame(ORIGIN, map_crs(crs))
    ring = 20.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    cover = shapely.Polygon(frame.map_from_enu(ring)[:, :2])
    wkt = frame.horizontal.to_wkt()
    grid = Grid.over(shapely.bounds(cover), pixel=4.0, crs_wkt=wkt)
    reference = HeightReference.promised("orthometric", "egm96", frame.vertical)
    las = CellFile(grid, reference)
    raster, points = path / "surface.tif", path / "surface.las"
    with TiledWriter(raster, surface_profile(grid, frame, reference, ground)) as writer:
        for row, col, values, known in surface_tiles(ground, grid, frame, reference, cover):
            writer.write_tile(row, col, values, known)
            las.add(row, col, values, known)
    las.write(points, frame.horizontal)
    return raster, points


@pytest.mark.parametrize(
    ("crs", "unit", "name", "code"),
    [
        ("EPSG:6549+6360", US_SURVEY_FOOT, "ftUS", "6360"),
        ("EPSG:6549+8228", INTERNATIONAL_FOOT, "ft", "8228"),
        ("EPSG:6549+5703", 1.0, "m", "5703"),
        ("EPSG:6549+6360 ground 1.00008", US_SURVEY_FOOT, "ftUS", "6360"),
    ],
)
def test_a_surface_counts_heights_as_the_projects_crs_does(
    grids: Path, tmp_path: Path, ground: GroundField, crs: str, unit: float, name: str, code: str
) -> None:
    write_tiff(grids / GEOID18)
    raster, points = written(tmp_path, crs, ground)
    # by hand: H = h - N, in the unit
    wanted = (LEVEL - float(plane(LAT, LON))) / unit
    with rasterio.open(raster) as found:
        heights, sigmas = found.read(1, masked=True), found.read(2, masked=True)
        assert f'AUTHORITY["EPSG","{code}"]' in found.crs.to_wkt()
        assert all(band.endswith(f", {name}") for band in found.descriptions)
        assert found.tags()["VERTICAL_REFERENCE"].endswith(f", {name}")
    # m; float32, and the geoid's slope over 20 m
    assert np.abs(heights - wanted).max() * unit < 1e-3
    assert float(sigmas.mean()) * unit == pytest.approx(SIGMA, rel=1e-3)
    cloud = laspy.read(points)
    up = cloud.header.parse_crs().axis_info[2]
    assert up.unit_conversion_factor == pytest.approx(unit, rel=1e-12)
    assert np.abs(np.asarray(cloud.z) - wanted).max() * unit < 2e-3
    # its name has no unit: always m
    assert np.asarray(cloud["sigma_u"]) == pytest.approx(SIGMA, rel=1e-3)


def test_a_surface_in_feet_comes_back_as_the_heights_that_it_was_made_of(
    grids: Path, tmp_path: Path, ground: GroundField
) -> None:
    write_tiff(grids / GEOID18)
    raster, _ = written(tmp_path, "EPSG:6549+6360", ground)
    (tmp_path / "project.toml").write_text("")
    found = raster_field(
        Project.open(tmp_path), MapFrame(ORIGIN, map_crs("EPSG:6549")), raster,
        around=np.array([[-5.0, -5.0], [5.0, 5.0]]), sigma=None,
    )  # fmt: skip
    # m, over the origin, which lies on the ground
    assert float(found.z_at(np.zeros((1, 2)))[0]) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("crs", "up", "stored"),
    [
        ("EPSG:26917", "", LEVEL),
        ("EPSG:26917+6360", "NAVD88", (LEVEL - float(plane(LAT, LON))) / US_SURVEY_FOOT),
    ],
)
def test_a_raster_that_says_nad83_is_measured_without_the_grids_of_realisations_and_told(
    grids: Path, tmp_path: Path, crs: str, up: str, stored: float
) -> None:
    write_tiff(grids / GEOID18)
    nad83 = Datum.parse("NAD83(2011)@2010.0")
    frame = MapFrame(ORIGIN, map_crs("EPSG:6549"), gnss_datum=nad83)
    x, y, _ = MapFrame(ORIGIN, map_crs("EPSG:26917")).map_from_enu(np.zeros(3))
    with rasterio.open(
        tmp_path / "usgs.tif", "w", driver="GTiff", width=40, height=40, count=1, dtype="float32",
        crs=CRS(crs).to_wkt(), transform=rasterio.Affine(2.0, 0.0, x - 40.0, 0.0, -2.0, y + 40.0),
    ) as target:  # fmt: skip
        target.write(np.full((40, 40), stored, np.float32), 1)
    kind = "" if up else '[ground]\ndem_height_kind = "ellipsoidal"\n'
    (tmp_path / "project.toml").write_text(kind)
    found = raster_field(
        Project.open(tmp_path), frame, tmp_path / "usgs.tif",
        around=np.array([[-5.0, -5.0], [5.0, 5.0]]), sigma=None,
    )  # fmt: skip
    # m; float32 of 900 ft, and the geoid's slope over the raster
    assert float(found.z_at(np.zeros((1, 2)))[0]) == pytest.approx(0.0, abs=1e-3)
    assert "its datum NAD83 is taken as NAD83(2011)" in found.name


@pytest.mark.parametrize(
    ("crs", "kind", "metres", "told"),
    [
        ("EPSG:6549", "orthometric", False, "egm96 (EGM96 height), m"),
        ("EPSG:6549+6360", "ellipsoidal", False, "ellipsoid of the positions, m"),
        ("EPSG:6549+6360", "orthometric", True, "geoid18 (NAVD88 height), m"),
        ("EPSG:32161+6641", "orthometric", False, "geoid18 (PRVD02 height), m"),
        ("EPSG:6549+3855", "orthometric", False, "egm2008 (EGM2008 height), m"),
    ],
)
def test_what_heights_are_above_is_told_with_their_unit(
    crs: str, kind: str, metres: bool, told: str
) -> None:
    part = vertical_part(map_crs(crs))
    reference = HeightReference.promised(kind, "egm96", part, metres=metres)  # type: ignore[arg-type]
    assert reference.told.endswith(told)
    assert reference.unit == 1.0


def cones(frame: MapFrame) -> AssetTable:
    """A cone at the origin, and one 30 m to the north of which no height is known."""
    places = frame.map_from_enu(np.array([[0.0, 0.0, 0.0], [0.0, 30.0, 0.0]]))
    places[1, 2] = np.nan
    return AssetTable(
        layer="asset_points", columns={"class": np.array(["cone", "cone"], object)},
        offsets=np.arange(3), xy=places[:, :2].copy(), height=places[:, 2].copy(),
        holes=np.zeros(2, np.int64),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("crs", "unit", "drawn"),
    [
        ("EPSG:6549+6360", US_SURVEY_FOOT, US_SURVEY_FOOT),
        # a drawing has one unit, that of x and y
        ("EPSG:6549+5703", 1.0, US_SURVEY_FOOT),
        ("EPSG:32617+8228", INTERNATIONAL_FOOT, 1.0),
    ],
)
def test_assets_have_the_heights_that_the_projects_crs_promises(
    grids: Path, tmp_path: Path, crs: str, unit: float, drawn: float
) -> None:
    write_tiff(grids / GEOID18)
    frame = MapFrame(ORIGIN, map_crs(crs))
    point = SiteControl(name="P1", role="control", p_map=frame.map_from_enu(np.zeros(3)))
    site = SiteLayers(
        name="site", frame=frame, photos=(), footprints=(), cameras=(), control=(point,),
        assets=(cones(frame),),
    )  # fmt: skip
    # m, by hand: H = h - N
    wanted = LEVEL - float(plane(LAT, LON))
    column = site.layer("asset_points").columns["height_map"].tolist()
    assert column[0] * unit == pytest.approx(wanted, abs=1e-3)
    assert column[1] is None
    surveyed = site.layer("control").columns["height_map"].tolist()
    assert surveyed == pytest.approx([wanted / unit], abs=1e-3)
    assert "NAVD88" in site.metadata()["heights_of_map"]
    path = tmp_path / "site.dxf"
    report = Dxf().write_layers(site, [site.layer("asset_points")], path, DxfOptions(labels=False))
    lines = path.read_text().split()
    z = float(lines[lines.index("30", lines.index("POINT")) + 1])
    assert z * drawn == pytest.approx(wanted, abs=1e-3)
    assert report.height_kind == f"orthometric ({frame.vertical.name}, geoid geoid18)"


def test_a_stray_asset_beyond_the_geoid_has_no_such_height_and_stops_nothing(
    grids: Path, tmp_path: Path
) -> None:
    write_tiff(grids / GEOID18)
    frame = MapFrame(ORIGIN, map_crs("EPSG:6549+6360"))
    moved = cones(frame)
    # ft east: on the way to Africa, where someone's mouse left it
    moved.xy[1] += [3e7, 0.0]
    moved.height[1] = LEVEL
    site = SiteLayers(
        name="site", frame=frame, photos=(), footprints=(), cameras=(), assets=(moved,)
    )
    layer = site.layer("asset_points")
    assert [value is None for value in layer.columns["height_map"].tolist()] == [False, True]
    report = Dxf().write_layers(site, [layer], tmp_path / "site.dxf", DxfOptions(labels=False))
    assert "1 features of asset_points have no height and lie at z = 0" in report.warnings
    (grids / GEOID18).unlink()
    with pytest.raises(CrsError, match=GEOID18):
        SiteLayers(
            name="site", frame=frame, photos=(), footprints=(), cameras=(), assets=(moved,)
        ).layer("asset_points")


def test_assets_of_a_map_without_heights_have_none_of_the_map() -> None:
    frame = MapFrame(ORIGIN, map_crs("EPSG:6549"))
    site = SiteLayers(
        name="site", frame=frame, photos=(), footprints=(), cameras=(), assets=(cones(frame),)
    )
    assert site.layer("asset_points").columns["height_map"].tolist() == [None, None]
    assert "no vertical part" in site.metadata()["heights_of_map"]
