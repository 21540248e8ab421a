"""What the libraries below say of their data, for `georef doctor`.

A finding is (subject, fine, message). Everything is imported here and guarded: an installation
that is broken is what the doctor is asked about.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

Finding = tuple[str, bool, str]


def raster_findings() -> Sequence[Finding]:
    """Version of GDAL, and what `georef_gis.rasters.health` finds."""
    try:
        gdal = import_module("rasterio").__gdal_version__
    except Exception as error:
        return [("GDAL", False, f"rasterio cannot be imported ({error}); reinstall it")]
    return [("GDAL", True, gdal), *_hook("georef_gis.rasters")]


def geodesy_findings() -> Sequence[Finding]:
    """Version and data of PROJ, and what `georef_gis.geodesy.health` finds."""
    try:
        proj = import_module("pyproj")
        folder = import_module("pyproj.datadir").get_data_dir()
        findings = [("PROJ", True, f"{proj.proj_version_str}, data in {folder}")]
    except Exception as error:
        return [("PROJ", False, f"pyproj cannot be imported or has no data ({error})")]
    return [*findings, *_hook("georef_gis.geodesy")]


def _hook(module: str) -> Sequence[Finding]:
    """Findings of a module's function `health`, if it has one."""
    try:
        health = getattr(import_module(module), "health", None)
        return list(health()) if health is not None else []
    except Exception as error:
        return [(module, False, f"its examination failed ({type(error).__name__}: {error})")]
