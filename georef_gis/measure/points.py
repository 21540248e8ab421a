"""Measuring points: by one photo and the ground, or by several photos."""

from __future__ import annotations

from georef_gis.measure.intersecting import intersect_points
from georef_gis.measure.locating import locate_points
from georef_gis.measure.measured import MeasuredPoint, MeasuredPoints, Method
from georef_gis.model.control import Mark

__all__ = [
    "Mark", "MeasuredPoint", "MeasuredPoints", "Method", "intersect_points", "locate_points",
]  # fmt: skip
