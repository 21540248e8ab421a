"""Runs with logs on copies of the sample project, judged against its truth."""

from __future__ import annotations

import csv
import json
import sqlite3
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tool_cases import SAMPLE, Done, Site, copy_site, georef

from georef_gis.frames import log_so3
from georef_gis.simulate import FlightSettings, SimulatedFlight, simulate_flight
from georef_gis.simulate.ellipsoid import ecef_from_geodetic, rotation_ecef_from_ned

Array = NDArray[np.float64]
# what leads to the poses, without products
STEPS = "read_photos,navigate,orient_direct,orient_navigation"
# seed that the sample project was made with
SEED = 2009
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def navigation_site(folder: Path, photos: int = 16) -> Site:
    """Copy of the sample project over its DEM."""
    site = copy_site(folder / "site", photos)
    site.use_dem()
    return site


def only_poses(site: Site, *words: object) -> Done:
    """`georef run` up to the poses; it must not fail."""
    done = site.run("--only", STEPS, *words)
    assert done.code == 0, done.text
    return done


def rows(site: Site, table: str, **where: object) -> list[dict[str, Any]]:
    """Rows of the project's database."""
    with sqlite3.connect(site.folder / "georef.gpkg") as database:
        database.row_factory = sqlite3.Row
        found = [dict(row) for row in database.execute(f"SELECT * FROM {table}")]
    return [row for row in found if all(row[key] == value for key, value in where.items())]


def photo_times(site: Site) -> dict[str, tuple[Any, ...]]:
    """Time, its sigma, source and confidence by photo."""
    keys = ("time_gps", "time_sigma_s", "time_source", "match_confidence")
    return {row["photo_id"]: tuple(row[k] for k in keys) for row in rows(site, "photo")}


@cache
def truth() -> dict[str, dict[str, str]]:
    """Rows of truth/poses.csv by photo."""
    with (SAMPLE / "truth" / "poses.csv").open() as stream:
        return {row["photo"].removesuffix(".JPG"): row for row in csv.DictReader(stream)}


@cache
def flight() -> SimulatedFlight:
    """The flight that the sample project was made of."""
    return simulate_flight(FlightSettings(), SEED)


def errors(site: Site, kind: str = "navigation") -> tuple[list[str], Array, Array]:
    """Photos, truth less pose (n, 6) and its covariance (n, 6, 6); enu, m and rad."""
    with sqlite3.connect(site.folder / "georef.gpkg") as database:
        found = database.execute("SELECT value FROM meta WHERE key = 'origin'").fetchone()
    lat, lon, h = json.loads(found[0])
    p0 = ecef_from_geodetic(np.radians(lat), np.radians(lon), h)
    R_ecef_enu = rotation_ecef_from_ned(np.radians(lat), np.radians(lon)) @ ENU_FROM_NED.T
    names, off, covariances = [], [], []
    for row in rows(site, "pose", kind=kind):
        true = truth()[row["photo_id"]]
        place = [float(true[k]) for k in ("lat_deg", "lon_deg", "height_ellipsoidal_m")]
        p = R_ecef_enu.T @ (ecef_from_geodetic(*np.radians(place[:2]), place[2]) - p0)
        R = np.array([float(true[f"R_ecef_from_cam_{i}{j}"]) for i in range(3) for j in range(3)])
        R_est = np.array(json.loads(row["rotation"])).reshape(3, 3)
        turn = log_so3(R_ecef_enu.T @ R.reshape(3, 3) @ R_est.T)
        off.append([*(p - [row["x_enu"], row["y_enu"], row["z_enu"]]), *turn])
        covariances.append(_full(json.loads(row["covariance"])))
        names.append(row["photo_id"])
    return names, np.array(off).reshape(-1, 6), np.array(covariances).reshape(-1, 6, 6)


def _full(upper: list[float]) -> Array:
    out = np.zeros((6, 6))
    out[np.triu_indices(6)] = upper
    return out + np.triu(out, 1).T


def worst_ratio(site: Site, kind: str = "navigation") -> float:
    """Largest error of a pose's component in its sigmas."""
    names, off, C = errors(site, kind)
    assert names
    return float(np.max(np.abs(off) / np.sqrt(np.einsum("nii->ni", C))))


def summary(site: Site, tool: str) -> dict[str, Any]:
    """What the last run of a tool told."""
    last = max(rows(site, "run", tool=f"georef:{tool}"), key=lambda row: row["fid"])
    return dict(json.loads(last["summary"]))


__all__ = ["SAMPLE", "SEED", "STEPS", "errors", "flight", "georef", "navigation_site",
           "only_poses", "photo_times", "rows", "summary", "truth", "worst_ratio"]  # fmt: skip
