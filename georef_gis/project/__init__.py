"""A project on disk: settings (project.toml), database (georef.gpkg), fingerprints of files."""

from georef_gis.project.database import Database, Srs
from georef_gis.project.fingerprint import fingerprint
from georef_gis.project.project import Project
from georef_gis.project.settings import Settings, read_settings
from georef_gis.project.template import render_settings

__all__ = [
    "Database",
    "Project",
    "Settings",
    "Srs",
    "fingerprint",
    "read_settings",
    "render_settings",
]
