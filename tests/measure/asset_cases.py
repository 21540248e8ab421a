"""Stores of assets for tests, and what another program does to their file."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from georef_gis.geodesy import CRS
from georef_gis.measure.assets.asset import Click, Draft, Quality
from georef_gis.measure.assets.domain import load_domain
from georef_gis.measure.assets.file import ASSETS_FILE
from georef_gis.measure.assets.store import AssetStore
from georef_gis.project import Srs

UTM = CRS.from_epsg(32617)
SRS = Srs(name=UTM.name, wkt=UTM.to_wkt("WKT1_GDAL"), code=32617)
E, N = 500000.0, 4428000.0

QUALITY = Quality(
    sigma_e=0.02, sigma_n=0.03, sigma_u=0.05, corr_en=0.25, semi_major=0.08, semi_minor=0.05,
    azimuth=30.0, conf=0.95, dof=3, n_rays=3, method="intersect",
    clicks=(Click(photo_id="flight/IMG_1", u=10.5, v=20.25), Click(photo_id="IMG_2", u=1.0, v=2.0)),
)  # fmt: skip


def store_at(folder: Path, *, wait: float = 5.0, srs: Srs = SRS) -> AssetStore:
    return AssetStore(folder / ASSETS_FILE, load_domain(folder), srs, wait=wait)


def cone(east: float = 0.0, north: float = 0.0, **more: Any) -> Draft:
    return Draft(kind="cone", vertices=((E + east, N + north, 270.0),), **more)


def edge(*places: tuple[float, float], **more: Any) -> Draft:
    vertices = tuple((E + e, N + n, 270.0) for e, n in places)
    return Draft(kind="lane_edge", vertices=vertices, **more)


def sql(folder: Path, statement: str, *values: Any) -> list[Any]:
    """What another program does to the file."""
    with closing(sqlite3.connect(folder / ASSETS_FILE)) as connection, connection:
        return connection.execute(statement, values).fetchall()
