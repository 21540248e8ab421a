from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from raster_cases import UTM_17N, make_profile, smooth, write

from georef_gis.errors import CrsError
from georef_gis.rasters import geokeys
from georef_gis.rasters.writer import TiledWriter

CRSS = {
    "utm": "EPSG:26917",
    "state-plane-ftus": "EPSG:6549",
    "state-plane-metre": "EPSG:6602",
    "compound-ftus": "EPSG:6527+6360",
    "compound-mixed-units": "EPSG:32617+6360",
    "compound-one-code": "EPSG:7415",
    "geographic": "EPSG:4326",
    "geographic-3d": "EPSG:4979",
    "northing-first": "EPSG:2193",
    "web": "EPSG:3857",
    "custom-lcc-ftus": "+proj=lcc +lat_1=40 +lat_2=41.5 +lat_0=39.7 +lon_0=-82.3 +x_0=600000"
    " +y_0=0 +ellps=GRS80 +units=us-ft",
    "custom-tmerc": "+proj=tmerc +lat_0=40 +lon_0=-82 +k=0.99995 +x_0=1000 +datum=WGS84",
}


# WKT 1 cannot say three-dimensional.
@pytest.mark.parametrize(
    ("name", "version"),
    [(name, "WKT2_2019") for name in CRSS]
    + [(name, "WKT1_GDAL") for name in CRSS if name != "geographic-3d"],
)
def test_crs_survives(tmp_path: Path, name: str, version: str) -> None:
    crs = pyproj.CRS(CRSS[name])
    write(tmp_path / "a.tif", smooth(30, 30, 3), crs_wkt=crs.to_wkt(version))
    with rasterio.open(tmp_path / "a.tif") as dataset:
        found = pyproj.CRS.from_wkt(dataset.crs.to_wkt(version="WKT2_2019"))
        transform = dataset.transform
    assert found.equals(crs, ignore_axis_order=True)
    assert [a.unit_name for a in found.axis_info] == [a.unit_name for a in crs.axis_info]
    assert tuple(transform)[:6] == (0.25, 0.0, 500_000.0, 0.0, -0.25, 4_400_000.0)


@pytest.mark.parametrize("name", ["utm", "state-plane-ftus", "compound-ftus", "geographic"])
def test_keys_by_hand_agree_with_those_of_gdal(name: str) -> None:
    wkt = pyproj.CRS(CRSS[name]).to_wkt("WKT1_GDAL")
    profile = make_profile(smooth(30, 30, 3), crs_wkt=wkt)

    def short_keys(tags: list[geokeys.Tag]) -> dict[int, int]:
        data = next(np.frombuffer(t.data, "<u2") for t in tags if t.code == 34735)
        return {int(k): int(v) for k, place, _, v in data[4:].reshape(-1, 4) if not place}

    ours, theirs = short_keys(geokeys._by_hand(profile)), short_keys(geokeys._by_gdal(profile))
    # GDAL adds some, and may leave the unit of heights to their code
    both = ours.keys() & theirs.keys()
    assert {1024, 1025} < both
    assert {key: ours[key] for key in both} == {key: theirs[key] for key in both}


def test_a_code_alone_is_enough(tmp_path: Path) -> None:
    write(tmp_path / "a.tif", smooth(30, 30, 3), crs_wkt="", epsg=6549)
    with rasterio.open(tmp_path / "a.tif") as dataset:
        assert dataset.crs.to_epsg() == 6549


def test_no_crs_stays_no_crs(tmp_path: Path) -> None:
    write(tmp_path / "a.tif", smooth(30, 30, 3), crs_wkt="")
    with rasterio.open(tmp_path / "a.tif") as dataset:
        assert dataset.crs is None


@pytest.mark.parametrize("wkt", ["nonsense", "PROJCS[", 'PROJCS["a",]]', "EPSG:26917"])
def test_broken_wkt_is_refused_before_the_work(tmp_path: Path, wkt: str) -> None:
    with pytest.raises(CrsError, match="CRS"):
        TiledWriter(tmp_path / "a.tif", make_profile(smooth(30, 30, 3), crs_wkt=wkt))


def test_wkt_beside_another_code_is_refused() -> None:
    with pytest.raises(CrsError, match="26917"):
        geokeys.geo_tags(make_profile(smooth(30, 30, 3), epsg=26918))


def test_common_crss_need_no_rasterio() -> None:
    code = (
        "import sys; from georef_gis.rasters import geokeys, profile, writer;"
        "p = profile.RasterProfile(width=9, height=9, transform=(1, 0, 0, 0, -1, 0),"
        f"crs_wkt={UTM_17N!r});"
        "geokeys.geo_tags(p); sys.exit('rasterio' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
