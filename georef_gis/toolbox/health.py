"""What the libraries below say of their data, for `georef doctor`.

A finding is (subject, fine, message); fine is None of what is not there and need not be. Everything
is imported here and guarded: an installation that is broken is what the doctor is asked about.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from georef_gis.errors import InputError

Finding = tuple[str, bool | None, str]


def raster_findings() -> Sequence[Finding]:
    """Version of GDAL, and what `georef_gis.rasters.health` finds."""
    try:
        gdal = import_module("rasterio").__gdal_version__
    except Exception as error:
        return [("GDAL", False, f"rasterio cannot be imported ({error}); reinstall it")]
    return [("GDAL", True, gdal), *_hook("georef_gis.rasters")]


def geodesy_findings(folder: Path = Path()) -> Sequence[Finding]:
    """Version and data of PROJ, its grids, and those that the project of a folder lacks."""
    try:
        proj = import_module("pyproj")
        data = import_module("pyproj.datadir").get_data_dir()
        findings = [("PROJ", True, f"{proj.proj_version_str}, data in {data}")]
    except Exception as error:
        return [("PROJ", False, f"pyproj cannot be imported or has no data ({error})")]
    try:
        return [*findings, *_grids(folder)]
    except Exception as error:
        return [*findings, ("grids", False, f"their examination failed ({error})")]


def _grids(folder: Path) -> Sequence[Finding]:
    """Folder of the grids, those that are there, and what the project of a folder lacks."""
    grids = import_module("georef_gis.project.grids")
    # The project's settings may name another folder.
    project = grids.open_or_none(folder)
    try:
        needs = grids.needs_of(project) if project is not None else ()
    finally:
        if project is not None:
            project.close()
    names, bad = [], []
    for path in grids.installed_grids():
        try:
            names.append(grids.examine_grid(path, whole=False).name)
        except InputError as error:
            bad.append(("grid", False, str(error)))
    where = grids.grids_folder()
    here = ("grids", True, f"{len(names)} in {where}: {', '.join(names)}")
    none = ("grids", None, f"none in {where}; EGM96 is built in, `georef grids` tells of others")
    lacking = [
        ("grid lacking", False, f"{need.name} ({need.reason}); {grids.how_to_get(need.name)}")
        for need in needs
        if not need.is_there
    ]
    return [here if names else none, *bad, *lacking]


def _hook(module: str) -> Sequence[Finding]:
    """Findings of a module's function `health`, if it has one."""
    try:
        health = getattr(import_module(module), "health", None)
        return list(health()) if health is not None else []
    except Exception as error:
        return [(module, False, f"its examination failed ({type(error).__name__}: {error})")]
