"""Rasters of heights that users give: of any CRS, unit and kind, with and without sigmas."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import rasterio
import shapely
from rasterio import Affine

from georef_gis.errors import CrsError, GeorefError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, Origin, geoid_undulation, parse_crs
from georef_gis.measure.surface.field import GroundField, HeightField
from georef_gis.measure.surface.raster import HeightReference, surface_profile, surface_tiles
from georef_gis.model.grid import Grid
from georef_gis.model.tin import EnuPlane, SquareCells, tin_terrain
from georef_gis.project import Project
from georef_gis.rasters.writer import TiledWriter
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT
from processing_algorithms.surface.given import raster_field

ORIGIN = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=277.6)
FRAME = MapFrame(ORIGIN, parse_crs("EPSG:32617"))
N = float(geoid_undulation(ORIGIN.lat, ORIGIN.lon))
AROUND = np.array([[-30.0, -30.0], [30.0, 30.0]])
HERE = np.array([[0.0, 0.0]])


def project(folder: Path, text: str = "") -> Project:
    (folder / "project.toml").write_text(f"[ground]\n{text}\n")
    return Project.open(folder)


def raster(
    folder: Path, values: Array | float, *, crs: str = "EPSG:32617", unit: str = "",
    shift: float = 0.0, turn: float = 0.0,
) -> Path:  # fmt: skip
    """Cells of 2 m, 60 x 60, about the origin; without CRS if that is empty."""
    frame = MapFrame(ORIGIN, parse_crs(crs or "EPSG:32617"))
    step = 2.0 / (US_SURVEY_FOOT if crs == "EPSG:6601" else 1.0)
    x, y = frame.map_from_enu([0.0, 0.0, 0.0])[:2]
    path = folder / "given.tif"
    c, s = step * math.cos(turn), step * math.sin(turn)
    place = Affine(c, s, x - 30 * step + shift, s, -c, y + 30 * step)
    with rasterio.open(
        path, "w", driver="GTiff", width=60, height=60, count=1, dtype="float32",
        crs=crs or None, transform=place,
    ) as target:  # fmt: skip
        target.write(np.broadcast_to(np.float32(values), (60, 60)), 1)
        if unit:
            target.set_band_unit(1, unit)
    return path


def read(folder: Path, path: Path, text: str = "", **given: float) -> HeightField:
    values = {"sigma": None} | given
    return raster_field(project(folder, text), FRAME, path, around=AROUND, **values)  # type: ignore[arg-type]


def height(field: HeightField) -> float:
    """Above the ellipsoid amid the raster, m."""
    return float(field.z_at(HERE)[0]) + ORIGIN.height_ellipsoidal


@pytest.mark.parametrize(
    ("crs", "unit", "text", "stored", "expected"),
    [
        ("EPSG:32617", "", "", 310.0, 310.0 + N),
        ("EPSG:32617", "", 'dem_height_kind = "ellipsoidal"', 310.0, 310.0),
        ("EPSG:32617", "ft", "", 1000.0, 1000.0 * INTERNATIONAL_FOOT + N),
        ("EPSG:32617+5773", "", 'dem_height_kind = "ellipsoidal"', 310.0, 310.0 + N),
        ("EPSG:6601", "US survey foot", "", 1000.0, 1000.0 * US_SURVEY_FOOT + N),
        ("EPSG:6601", "", 'dem_unit = "us-ft"', 1000.0, 1000.0 * US_SURVEY_FOOT + N),
        ("EPSG:6601", "", 'dem_unit = "m"', 310.0, 310.0 + N),
    ],
    ids=["metres", "ellipsoidal", "feet of the band", "geoid of the CRS", "survey feet",
         "feet of the project", "metres of the project"],
)  # fmt: skip
def test_heights_are_metres_above_the_ellipsoid(
    crs: str, unit: str, text: str, stored: float, expected: float, tmp_path: Path
) -> None:
    found = read(tmp_path, raster(tmp_path, stored, crs=crs, unit=unit), text)
    # m; float32 of feet
    assert height(found) == pytest.approx(expected, abs=1e-3)


def test_feet_that_nobody_stated_are_asked_for(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"given.tif: .*m or US survey foot; set .* dem_unit"):
        read(tmp_path, raster(tmp_path, 1000.0, crs="EPSG:6601"))


def test_sigma_is_as_given_or_a_metre(tmp_path: Path) -> None:
    path = raster(tmp_path, 310.0)
    for field, sigma in ((read(tmp_path, path, sigma=0.2), 0.2), (read(tmp_path, path), 1.0)):
        assert field.common.sigma == pytest.approx(sigma / math.sqrt(2))
        assert field.local(HERE) == pytest.approx([sigma / math.sqrt(2)])


def test_numbers_that_are_no_heights_are_none(tmp_path: Path) -> None:
    values = np.full((60, 60), 310.0)
    values[:20], values[20:22], values[22:24] = -9999.0, np.inf, np.nan
    found = read(tmp_path, raster(tmp_path, values))
    z = found.z_at(np.array([[0.0, 40.0], [0.0, 18.0], [0.0, 13.5], [0.0, 0.0]]))
    assert np.isnan(z[:3]).all()
    assert np.isfinite(z[3])
    with pytest.raises(InputError, match="has no height about the shape"):
        read(tmp_path, raster(tmp_path, math.nan))


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"crs": ""}, "has no CRS"), ({"turn": 0.2}, "north-up"), ({"shift": 5e4}, "does not lie")],
    ids=["no CRS", "turned", "elsewhere"],
)
def test_raster_that_cannot_be_used_is_refused(
    changes: dict[str, float], words: str, tmp_path: Path
) -> None:
    with pytest.raises((InputError, CrsError), match=words) as caught:
        read(tmp_path, raster(tmp_path, 310.0, **changes))  # type: ignore[arg-type]
    assert isinstance(caught.value, GeorefError)
    assert "\n" not in str(caught.value)


def test_own_surface_brings_its_two_sigmas_along(tmp_path: Path) -> None:
    """4 m that all share and 6 cm of each place, over a slope, in feet."""
    cells = SquareCells(left=-100.0, top=100.0, cell=4.0)
    x = cells.left + (np.arange(50) + 0.5) * cells.cell
    z = 280.0 + 0.05 * np.stack(np.meshgrid(x, -x), axis=-1)[..., 0]
    terrain = tin_terrain(
        EnuPlane(origin=ORIGIN, level=280.0), cells, z, np.full((4, 4), 0.06), kind="tin",
        sigma=0.1, sigma_shared=0.0,
    )  # fmt: skip
    field = GroundField.of(terrain, "slope", level=4.0)
    feet = MapFrame(ORIGIN, parse_crs("EPSG:6601"))
    ring = feet.map_from_enu(60.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]))
    cover = shapely.Polygon(ring[:, :2])
    grid = Grid.over(shapely.bounds(cover), pixel=3.0, crs_wkt=feet.horizontal.to_wkt())
    for kind in ("orthometric", "ellipsoidal"):
        reference = HeightReference(kind=kind)  # type: ignore[arg-type]
        path = tmp_path / f"{kind}.tif"
        with TiledWriter(path, surface_profile(grid, feet, reference, field)) as writer:
            for row, col, values, known in surface_tiles(field, grid, feet, reference, cover):
                writer.write_tile(row, col, values, known)
        found = read(tmp_path, path)
        # m; steps of 0.12 mm, bilinear in cells of 1 m
        assert height(found) == pytest.approx(280.0, abs=2e-3)
        assert found.common.sigma == pytest.approx(4.0, abs=1e-3)
        assert found.local(HERE) == pytest.approx([0.06], abs=2e-3)
