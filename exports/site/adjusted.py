"""Layers of surveyed points and of an adjustment's ground points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from exports.site import schemas
from exports.site.adjustment import read_points
from exports.site.build import number, place
from exports.site.columns import Column, Layer, Places
from exports.site.map_heights import map_heights
from exports.site.schemas import Value
from exports.site.values import SiteControl, SiteValues
from georef_gis.frames import Array, R_ecef_from_enu


def control_layer(site: SiteValues) -> Layer:
    """Surveyed points with what the adjustment made of them."""
    points = np.zeros((0, 6))
    if site.control:
        p_map = np.array([one.p_map for one in site.control])
        known = np.where(np.isfinite(p_map[:, 2]), p_map[:, 2], 0.0)
        geo = site.frame.geo_from_map(np.column_stack([p_map[:, :2], known]))
        points = place(site.frame, np.column_stack([geo[:, :2], p_map[:, 2]]))
        points[:, 4:] = p_map[:, :2]
    in_map = map_heights(site.frame, points[:, :2], points[:, 2])
    rows = [
        {**_control_values(site, one, points[i]), "height_map": number(float(in_map[i]))}
        for i, one in enumerate(site.control)
    ]
    return Layer.of_rows(
        "control", "Control and check points", "Point", schemas.CONTROL_FIELDS, rows,
        Places.of_points(points),
    )  # fmt: skip


def _control_values(site: SiteValues, one: SiteControl, point: Array) -> dict[str, Value]:
    values: dict[str, Value] = dict.fromkeys(f.name for f in schemas.CONTROL_FIELDS)
    values |= {
        "name": one.name,
        "role": one.role,
        **_heights(point),
        "datum": one.datum or None,
        "survey_sigma_h_m": number(one.sigma_h),
        "survey_sigma_v_m": number(one.sigma_v),
        "marks": one.marks,
    }
    if one.adjusted is not None:
        values |= _adjusted_values(one.adjusted, _shared_level(site))
    return values


def _heights(point: Array) -> dict[str, Value]:
    return {
        "lon_deg": float(point[0]),
        "lat_deg": float(point[1]),
        "height_ellipsoidal_m": number(float(point[2])),
        "height_orthometric_m": number(float(point[3])),
    }


def _adjusted_values(told: Mapping[str, Any], level: float) -> dict[str, Value]:
    """Offsets and sigmas from the report, whose axes are the project's: level within 1 km."""
    out: dict[str, Value] = {"rays": told.get("rays"), "residual_px": told.get("rms_px")}
    off, sigma = told.get("off_m") or (None,) * 3, told.get("sigma_m") or (None,) * 3
    for name, key, d, s in zip(("east", "north", "up"), "enu", off, sigma, strict=True):
        out[f"off_{name}_m"], out[f"sigma_{key}_m"] = number(d), number(s)
    if sigma[2] is not None:
        out["sigma_u_m"] = number(math.hypot(sigma[2], level))
    return out


def tie_points_layer(site: SiteValues) -> Layer:
    """Ground points of the adjustment that the poses are from; empty without one.

    Raises
    ------
    ExportError
        If they cannot be read.
    """
    layer = Layer.of_rows("tie_points", "Tie points", "Point", schemas.TIE_POINT_FIELDS, ())
    if site.adjustment is None:
        return layer
    ground = read_points(site.adjustment)
    if not len(ground):
        return layer
    points = place(site.frame, site.frame.origin.geo_from_enu(ground.p_enu))
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", _local(site, points, ground.covariance)), 0.0))
    level = _shared_level(site)
    known = {
        "point": np.arange(len(points)),
        "lon_deg": points[:, 0],
        "lat_deg": points[:, 1],
        "height_ellipsoidal_m": points[:, 2],
        "height_orthometric_m": points[:, 3],
        "rays": ground.rays,
        "residual_px": ground.residual_px,
        "sigma_e_m": sigma[:, 0],
        "sigma_n_m": sigma[:, 1],
        "sigma_u_m": np.hypot(sigma[:, 2], level),
        "sigma_u_block_m": sigma[:, 2],
    }
    columns = {f.name: Column.of(f.kind, known[f.name]) for f in layer.fields}
    return replace(layer, columns=columns, places=Places.of_points(points))


def _shared_level(site: SiteValues) -> float:
    """One sigma, m, of the level that adjusted cameras and points share; 0 with control."""
    poses = [p.pose for p in site.photos if p.pose is not None and p.pose.kind == "adjusted"]
    return float(np.median([pose.sigma_height_shared for pose in poses])) if poses else 0.0


def _local(site: SiteValues, points: Array, covariance: Array) -> Array:
    """Covariances towards east, north, up at the points' own places; (n, 3, 3)."""
    # a site is small against the Earth: one rotation, that of its middle, holds for all
    lon, lat = np.radians(np.median(points[:, :2], axis=0))
    R = R_ecef_from_enu(float(lat), float(lon)).T @ site.frame.origin.R_ecef_from_enu
    return np.asarray(R @ covariance @ R.T)
