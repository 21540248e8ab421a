"""The ground from adjusted points as a file of the project."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from georef_gis.geodesy import Origin
from georef_gis.model.tin import EnuPlane, SquareCells, TinTerrain, tin_terrain
from georef_gis.project.columns_file import columns_of, write_columns

# name of the file in a project's folder `adjustment`
SURFACE = "surface.npz"
KIND = "surface"


def save_surface(path: Path, terrain: TinTerrain) -> None:
    """Write a TIN or plane, whole or not at all, in a folder that exists."""
    write_columns(
        path,
        KIND,
        {
            "surface": terrain.kind,
            "level": terrain.frame.origin.height_ellipsoidal,
            # float32 relative to a level nearby: 1e-5 m over 100 m of relief
            "middle": float(np.mean(terrain.heights)),
            "heights": (terrain.heights - np.mean(terrain.heights)).astype(np.float32),
            "sigmas": terrain.sigmas.astype(np.float32),
            "place": [terrain.left, terrain.top, terrain.cell[0]],
            "plane_level": _plane_of(terrain).level,
            "origin": [terrain.frame.origin.lat, terrain.frame.origin.lon],
            "sigma": [terrain.sigma, terrain.sigma_shared],
        },
    )


def load_surface(path: Path) -> TinTerrain:
    """Read what `save_surface` wrote.

    Raises
    ------
    InputError
        If the file is missing, cut off or none of ours.
    """
    with columns_of(path, KIND) as read:
        lat, lon = (float(v) for v in read["origin"])
        left, top, cell = (float(v) for v in read["place"])
        sigma, shared = (float(v) for v in read["sigma"])
        origin = Origin(lat=lat, lon=lon, height_ellipsoidal=float(read["level"]))
        return tin_terrain(
            EnuPlane(origin=origin, level=float(read["plane_level"])),
            SquareCells(left=left, top=top, cell=cell),
            read["heights"].astype(np.float64) + float(read["middle"]),
            read["sigmas"].astype(np.float64),
            kind="plane" if str(read["surface"]) == "plane" else "tin",
            sigma=sigma, sigma_shared=shared,
        )  # fmt: skip


def _plane_of(terrain: TinTerrain) -> EnuPlane:
    if not isinstance(terrain.frame, EnuPlane):
        raise ValueError("a surface lies on the project's own plane")
    return terrain.frame
