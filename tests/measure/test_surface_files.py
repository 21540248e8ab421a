"""Surfaces as GeoTIFF and LAS, read back by other libraries; profiles along lines."""

from __future__ import annotations

import io
import math
from datetime import date
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
import shapely

from georef_gis.errors import ExportError, GeometryError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, Origin, geoid_undulation, parse_crs
from georef_gis.measure.report.draw import png
from georef_gis.measure.surface.field import GroundField, sigma_at
from georef_gis.measure.surface.las import Extra, write_las
from georef_gis.measure.surface.profile import profile_along, profile_figure
from georef_gis.measure.surface.raster import (
    LOCAL_BAND,
    NODATA,
    SIGMA_BAND,
    HeightReference,
    surface_profile,
    surface_tiles,
)
from georef_gis.model.grid import Grid
from georef_gis.model.terrain import FlatTerrain
from georef_gis.model.tin import EnuPlane, SquareCells, TinTerrain, tin_terrain
from georef_gis.rasters.writer import TiledWriter

ORIGIN = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=277.6)
# US survey feet, and metres
FRAMES = {code: MapFrame(ORIGIN, parse_crs(code)) for code in ("EPSG:6601", "EPSG:32617")}
ORTHOMETRIC, ELLIPSOIDAL = HeightReference(kind="orthometric"), HeightReference(kind="ellipsoidal")
# m: shared by all heights, and of photos and surface together
SHARED, LEVEL = 0.05, 0.4


def slope(xy: Array) -> Array:
    return np.asarray(280.0 + xy @ np.array([0.05, -0.02]))


def tin() -> TinTerrain:
    """A slope, whose sigma grows to the east."""
    cells = SquareCells(left=-400.0, top=400.0, cell=4.0)
    x = cells.left + (np.arange(200) + 0.5) * cells.cell
    y = cells.top - (np.arange(200) + 0.5) * cells.cell
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    sigmas = 0.1 + 0.0005 * (xy[..., 0] + 400.0)
    return tin_terrain(
        EnuPlane(origin=ORIGIN, level=280.0), cells, slope(xy), sigmas, kind="tin", sigma=0.3,
        sigma_shared=SHARED,
    )  # fmt: skip


def field() -> GroundField:
    return GroundField.of(tin(), "slope", level=LEVEL)


def box(frame: MapFrame, half: float) -> shapely.Polygon:
    """Square about the origin on the map, in its units."""
    corners = half * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return shapely.Polygon(frame.map_from_enu(corners)[:, :2])


# -- GeoTIFF -------------------------------------------------------------------------------------


def written(path: Path, frame: MapFrame, reference: HeightReference, *, pixel: float) -> Path:
    cover = box(frame, 150.0)
    grid = Grid.over(shapely.bounds(cover), pixel=pixel, crs_wkt=frame.horizontal.to_wkt())
    with TiledWriter(path, surface_profile(grid, frame, reference, field())) as writer:
        for row, col, values, known in surface_tiles(field(), grid, frame, reference, cover):
            writer.write_tile(row, col, values, known)
    return path


@pytest.mark.parametrize("code", list(FRAMES))
def test_raster_holds_heights_above_the_geoid_and_their_sigma(code: str, tmp_path: Path) -> None:
    frame = FRAMES[code]
    unit = 1200 / 3937 if code == "EPSG:6601" else 1.0
    path = written(tmp_path / "s.tif", frame, ORTHOMETRIC, pixel=0.5 / unit)
    with rasterio.open(path) as ds:
        heights, sigmas = ds.read(1, masked=True), ds.read(2, masked=True)
        assert ds.nodata == NODATA
        assert ds.descriptions[1] == SIGMA_BAND
        assert "EGM96" in ds.crs.to_wkt()
        assert ds.tags()["VERTICAL_REFERENCE"].startswith("above the geoid egm96")
        # what all heights share: the surface's own and the photos'
        common = math.hypot(SHARED, LEVEL)
        assert float(ds.tags()["SIGMA_COMMON_M"]) == pytest.approx(common, abs=1e-4)
        assert ds.descriptions[2] == LOCAL_BAND
        both = np.hypot(ds.read(3, masked=True), common)
        # m; steps of 0.12 mm in both
        assert np.abs(both - sigmas).max() < 1.3e-4
        rows, cols = np.array([200, 300, 411]), np.array([250, 402, 333])
        x, y = rasterio.transform.xy(ds.transform, rows, cols)
    geo = frame.geo_from_map(np.column_stack([x, y, np.full(3, 280.0)]))
    place = frame.origin.enu_from_geo(geo)
    expected = slope(place[:, :2]) - geoid_undulation(geo[:, 0], geo[:, 1])
    # m; float32 at 300 m, cells of 4 m on a slope that bends with the Earth
    assert np.asarray(heights)[rows, cols] == pytest.approx(expected, abs=2e-3)
    assert np.asarray(sigmas)[rows, cols] == pytest.approx(
        sigma_at(field(), place[:, :2]), rel=1e-3
    )


def test_nothing_is_told_beyond_the_cover(tmp_path: Path) -> None:
    frame = FRAMES["EPSG:32617"]
    with rasterio.open(written(tmp_path / "s.tif", frame, ELLIPSOIDAL, pixel=0.5)) as ds:
        inside = ds.read_masks(1) > 0
        cell = ds.transform.a * -ds.transform.e
        assert not inside[0, 0]
        # m2; a rim of cells of half a metre
        assert inside.sum() * cell == pytest.approx(300.0**2, rel=0.01)


def test_geoid_lies_between_the_two_kinds_of_height(tmp_path: Path) -> None:
    frame = FRAMES["EPSG:32617"]
    values = {}
    for reference in (ORTHOMETRIC, ELLIPSOIDAL):
        with rasterio.open(
            written(tmp_path / f"{reference.kind}.tif", frame, reference, pixel=2.0)
        ) as ds:
            values[reference.kind] = ds.read(1)[70, 70]
            told = ds.tags()["VERTICAL_REFERENCE"]
            compound = len(parse_crs(ds.crs.to_wkt()).sub_crs_list) == 2
            assert compound == (reference.kind == "orthometric")
            assert ("ellipsoid" in told) == (reference.kind == "ellipsoidal")
    n = float(geoid_undulation(ORIGIN.lat, ORIGIN.lon))
    # m; the geoid bends by centimetres within 150 m
    assert values["ellipsoidal"] - values["orthometric"] == pytest.approx(n, abs=0.02)


# -- LAS -----------------------------------------------------------------------------------------


def test_las_is_read_back_to_a_millimetre_with_its_sigmas() -> None:
    rng = np.random.default_rng(0)
    n = 5000
    places = rng.uniform(0, 300, (n, 3)) + np.array([1_694_000.0, 219_000.0, 300.0])
    sigma = rng.random(n).astype(np.float32)
    stream = io.BytesIO()
    wkt = parse_crs("EPSG:6601+5773").to_wkt("WKT1_GDAL")
    write_las(
        stream, places, crs_wkt=wkt, made=date(2026, 11, 22),
        extras=[
            Extra(name="sigma_u", values=sigma, told="one sigma of the height, m"),
            Extra(name="rays", values=np.arange(n).astype(np.uint16), told="photos that see it"),
        ],
    )  # fmt: skip
    stream.seek(0)
    read = laspy.read(stream)
    assert str(read.header.version) == "1.4"
    assert read.header.point_format.id == 6
    assert np.abs(read.xyz - places).max() < 5.1e-4
    assert np.array_equal(read.sigma_u, sigma)
    assert np.array_equal(read.rays, np.arange(n))
    assert read.header.mins == pytest.approx(read.xyz.min(axis=0))
    assert read.header.maxs == pytest.approx(read.xyz.max(axis=0))
    assert read.header.creation_date == date(2026, 11, 22)
    assert (np.unique(read.return_number), np.unique(read.number_of_returns)) == ([1], [1])
    assert "EGM96" in read.header.parse_crs().name


@pytest.mark.parametrize("kind", ["orthometric", "ellipsoidal"])
def test_points_in_feet_have_heights_in_metres(kind: str) -> None:
    """Without a vertical part readers take heights to count as the map does."""
    stream = io.BytesIO()
    reference = HeightReference(kind=kind)  # type: ignore[arg-type]
    write_las(stream, np.zeros((1, 3)), crs_wkt=reference.point_wkt(parse_crs("EPSG:6601")))
    stream.seek(0)
    axes = laspy.read(stream).header.parse_crs().axis_info
    assert [axis.unit_name for axis in axes] == ["US survey foot", "US survey foot", "metre"]
    assert ("Ellipsoidal" in axes[2].name) == (kind == "ellipsoidal")


def test_las_without_points_or_crs_is_a_file() -> None:
    stream = io.BytesIO()
    write_las(stream, np.zeros((0, 3)), crs_wkt="")
    stream.seek(0)
    read = laspy.read(stream)
    assert read.header.point_count == 0
    assert read.header.parse_crs() is None


def test_las_of_points_too_far_apart_is_refused() -> None:
    with pytest.raises(ExportError, match="take a coarser step"):
        write_las(io.BytesIO(), [[0, 0, 0], [1e7, 0, 0]], crs_wkt="", scale=1e-3)
    with pytest.raises(ValueError, match="32 bytes"):
        Extra(name="a name that is longer than LAS can hold", values=np.zeros(1, np.uint8))


# -- profiles ------------------------------------------------------------------------------------


@pytest.mark.parametrize("code", list(FRAMES))
def test_profile_of_a_slope(code: str) -> None:
    """100 m to the east, then 60 m to the north; 5 m and -1.2 m of height."""
    frame = FRAMES[code]
    corners = np.array([[-50.0, 20.0, 0.0], [50.0, 20.0, 0.0], [50.0, 80.0, 0.0]])
    line = shapely.LineString(frame.map_from_enu(corners)[:, :2])
    found = profile_along(field(), frame, line, ELLIPSOIDAL, step=2.0)
    # m; the corners are at the origin's level, the ground 2 m above: 3e-7 longer
    assert found.corners == pytest.approx([0.0, 100.0, 160.0], abs=2e-3)
    assert len(found.station) == 81
    assert found.height[[0, 50, 80]] == pytest.approx([277.1, 282.1, 280.9], abs=5e-3)
    assert found.sigma == pytest.approx(np.hypot(found.sigma_local, math.hypot(SHARED, LEVEL)))
    # a shift of all heights is in no rise
    rise = np.hypot(found.sigma_local, found.sigma_local[0])
    assert found.sigma_rise[0] == 0.0
    assert found.sigma_rise[1:] == pytest.approx(rise[1:])
    # the surface grows less sure to the east
    assert found.sigma_local[50] > found.sigma_local[0]
    assert found.rows[0]["height_m"] == pytest.approx(277.1, abs=5e-3)
    assert png(profile_figure(found, title="slope"))[:4] == b"\x89PNG"


def test_step_follows_the_surface_and_is_bounded() -> None:
    frame = FRAMES["EPSG:32617"]
    line = shapely.LineString(frame.map_from_enu(np.array([[0.0, 0, 0], [90.0, 0, 0]]))[:, :2])
    found = profile_along(field(), frame, line, ORTHOMETRIC)
    assert np.diff(found.station)[:-1] == pytest.approx(np.full(len(found.station) - 2, 2.0))
    with pytest.raises(InputError, match="stations; take a longer step"):
        profile_along(field(), frame, line, ORTHOMETRIC, step=1e-5)


def test_profile_beside_the_surface_is_refused() -> None:
    frame = FRAMES["EPSG:32617"]

    class Nowhere(FlatTerrain):
        """Ground that nobody knows."""

        def height_on_map(self, frame: MapFrame, xy_map: Array) -> Array:
            return np.full(np.shape(xy_map)[:-1], np.nan)

    nowhere = GroundField.of(Nowhere(origin=ORIGIN, height_ellipsoidal=280.0, sigma=1.0), "nowhere")
    line = shapely.LineString(frame.map_from_enu(np.array([[0.0, 0, 0], [9.0, 0, 0]]))[:, :2])
    with pytest.raises(GeometryError, match="nowhere: has no height along the line"):
        profile_along(nowhere, frame, line, ORTHOMETRIC)
