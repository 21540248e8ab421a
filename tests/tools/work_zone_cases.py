"""Clicks on the cones, drums and signs of the sample project, by the true poses of its photos."""

from __future__ import annotations

import csv
import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tool_cases import Site

Array = NDArray[np.float64]
HEADER = "asset,class,photo,u,v,line,mutcd_code,width_in"
# Cones C01 to C13 lead the traffic to the left, drums D01 to D11 follow the line they end on.
TAPER, TANGENT = "T1", "G1"


def posed_site(folder: Path, photos: int = 5) -> Site:
    """Sample project with the poses of its tags and nothing more, which takes a second."""
    from tool_cases import copy_site, georef

    site = copy_site(folder, photos)
    for tool in ("read-photos", "orient-direct"):
        done = georef(tool, "--project", site.folder)
        assert done.code == 0, done.text
    return site


def copied(site: Site, folder: Path) -> Site:
    """Copy of a project."""
    shutil.copytree(site.folder, folder)
    return type(site)(folder)


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def ecef(lat_deg: float, lon_deg: float, h: float) -> Array:
    """Own lines: the geodesy of the product is not to be its own judge."""
    a, f = 6378137.0, 1 / 298.257223563
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    n = a / math.sqrt(1 - f * (2 - f) * math.sin(lat) ** 2)
    return np.array([
        (n + h) * math.cos(lat) * math.cos(lon),
        (n + h) * math.cos(lat) * math.sin(lon),
        (n * (1 - f) ** 2 + h) * math.sin(lat),
    ])  # fmt: skip


class TrueCamera:
    """Where the true photos show a place."""

    def __init__(self, truth: Path) -> None:
        self.poses = {
            row["photo"]: (
                ecef(*(float(row[k]) for k in ("lat_deg", "lon_deg", "height_ellipsoidal_m"))),
                np.array([[float(row[f"R_ecef_from_cam_{i}{j}"]) for j in range(3)]
                          for i in range(3)]),
            )
            for row in read(truth / "poses.csv")
        }  # fmt: skip
        self.c = json.loads((truth / "camera.json").read_text())

    def pixel(self, photo: str, place: Array, margin: float = 20.0) -> tuple[float, float] | None:
        """Pixel of a place (ECEF), None outside the photo."""
        centre, R = self.poses[photo]
        x, y, z = R.T @ (place - centre)
        if z <= 0:
            return None
        c = self.c
        x, y = x / z, y / z
        r2 = x * x + y * y
        # far outside of the lens's field the polynomial folds back into the picture
        if r2 > 1.0:
            return None
        radial = 1 + c["k1"] * r2 + c["k2"] * r2**2 + c["k3"] * r2**3
        xd = x * radial + 2 * c["p1"] * x * y + c["p2"] * (r2 + 2 * x * x)
        yd = y * radial + c["p1"] * (r2 + 2 * y * y) + 2 * c["p2"] * x * y
        u, v = c["fx"] * xd + c["cx"], c["fy"] * yd + c["cy"]
        inside = margin < u < c["width"] - margin and margin < v < c["height"] - margin
        return (float(u), float(v)) if inside else None


def clicks_csv(
    truth: Path, names: Sequence[str] | None = None, *, photos: Sequence[str] | None = None,
    one_photo: bool = False, noise_px: float = 0.3,
) -> str:  # fmt: skip
    """Table of clicks of objects, at the ground in the middle of each.

    Parameters
    ----------
    names
        Of objects; cones, drums and signs if there are none.
    one_photo
        Click each object only in the photo that shows most of them.
    """
    camera, rng = TrueCamera(truth), np.random.default_rng(5)
    kinds = {"cone": TAPER, "drum": TANGENT, "sign": "S1"}
    rows = [r for r in read(truth / "objects.csv") if not r["part"] and r["kind"] in kinds]
    rows = [r for r in rows if names is None or r["name"] in names]
    seen = {
        photo: {r["name"]: uv for r in rows if (uv := camera.pixel(photo, _place(r))) is not None}
        for photo in (photos or camera.poses)
    }
    if one_photo:
        best = max(seen, key=lambda photo: len(seen[photo]))
        seen = {best: seen[best]}
    lines = [HEADER]
    for r in rows:
        width = 39.37 * float(r["width_m"])
        code = "W20-1" if r["kind"] == "sign" else ""
        more = "," if r["kind"] == "sign" else f"{width:.1f}"
        for photo, found in seen.items():
            if r["name"] in found:
                u, v = found[r["name"]] + noise_px * rng.standard_normal(2)
                lines.append(f"{r['name']},{r['kind']},{photo},{u:.2f},{v:.2f},"
                             f"{kinds[r['kind']]},{code},{more.strip(',')}")  # fmt: skip
    return "\n".join(lines) + "\n"


def _place(row: dict[str, str]) -> Array:
    return ecef(*(float(row[k]) for k in ("lat_deg", "lon_deg", "height_ellipsoidal_m")))


def true_places(truth: Path) -> dict[str, Array]:
    """Places of the objects, ECEF m."""
    return {r["name"]: _place(r) for r in read(truth / "objects.csv") if not r["part"]}
