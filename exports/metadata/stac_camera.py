"""Pose and camera of a photo in the terms of STAC's perspective-imagery extension."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from exports.site.block import stored_camera
from georef_gis.errors import ExportError
from georef_gis.frames import R_PHOTO_FROM_CAM
from georef_gis.geodesy import CRS, Datum

if TYPE_CHECKING:
    from exports.site.site import SiteLayers
    from exports.site.values import SitePhoto
    from georef_gis.model.camera import Camera

PERSPECTIVE = "https://stac-extensions.github.io/perspective-imagery/v1.0.0/schema.json"
VIEW = "https://stac-extensions.github.io/view/v1.0.0/schema.json"
WGS84_GEOCENTRIC = 4978
_VALUES = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2", "readout_s",
           "sigma_f", "sigma_c")  # fmt: skip


def pose_properties(site: SiteLayers, one: SitePhoto) -> dict[str, Any]:
    """Place and rotation of a photo in the geocentric CRS of the positions; empty without pose.

    There they are exact: no scale of a map, no meridian convergence, no foot.
    """
    if one.pose is None:
        return {}
    origin = site.frame.origin
    center = origin.ecef_from_enu(one.pose.origin_enu)
    R_ecef_from_cam = origin.R_ecef_from_enu @ one.pose.R_enu_from_cam
    R_photo_from_ecef = R_PHOTO_FROM_CAM @ R_ecef_from_cam.T
    return {
        "pers:crs": geocentric(site.frame.gnss_datum),
        "pers:perspective_center": [round(float(x), 4) for x in center],
        "pers:rotation_matrix": [round(float(x), 12) for x in R_photo_from_ecef.ravel()],
    }


@lru_cache(maxsize=8)
def geocentric(datum: Datum) -> int | str:
    """Geocentric CRS of a datum: its EPSG code, else WKT; that of WGS 84 if not known."""
    if not datum.is_known:
        return WGS84_GEOCENTRIC
    base = datum.geographic_3d().to_json_dict()
    axes = [
        {"name": f"Geocentric {axis}", "abbreviation": axis, "direction": f"geocentric{axis}",
         "unit": "metre"}
        for axis in "XYZ"
    ]  # fmt: skip
    kept = {key: base[key] for key in ("datum", "datum_ensemble") if key in base}
    crs = CRS.from_json_dict({
        "type": "GeodeticCRS", "name": base["name"], **kept,
        "coordinate_system": {"subtype": "Cartesian", "axis": axes},
    })  # fmt: skip
    code = crs.to_epsg(min_confidence=20)
    return int(code) if code is not None else str(crs.to_wkt())


def camera_properties(site: SiteLayers, one: SitePhoto) -> dict[str, Any]:
    """Interior orientation of a photo as it is stored; empty where its camera is not known.

    The extension counts in mm, so its lengths are there only where the photo's tags state the
    focal length in mm; `georef:camera` holds the whole model in pixels.
    """
    known = {camera.id: camera for camera in site.cameras}
    try:
        camera = stored_camera(one, known)
    except ExportError:
        return {}
    model = {name: getattr(camera, name) for name in _VALUES}
    if camera.poly:
        model["poly"] = list(camera.poly)
    return {
        "pers:interior_orientation": _interior(one, camera),
        "georef:camera": {"model": camera.model, **model},
    }


def _interior(one: SitePhoto, camera: Camera) -> dict[str, Any]:
    photo = one.photo
    out: dict[str, Any] = {"camera_id": camera.id}
    if photo.make:
        out["camera_manufacturer"] = photo.make
    if photo.model:
        out["camera_model"] = photo.model
    out["sensor_array_dimensions"] = [camera.width, camera.height]
    if camera.model.startswith("brown"):
        half = math.atan(camera.width / 2.0 / (camera.fx + camera.b1))
        out["field_of_view"] = round(math.degrees(2.0 * half), 6)
    focal = photo.tags.get("EXIF:FocalLength")
    if not isinstance(focal, int | float) or not (math.isfinite(focal) and focal > 0.0):
        return out
    # The pitch with which the focal length of the tags is that of the calibration in pixels.
    across, down = focal / (camera.fx + camera.b1), focal / camera.fy
    off = (camera.cx - (camera.width - 1) / 2.0, (camera.height - 1) / 2.0 - camera.cy)
    out["focal_length"] = float(focal)
    out["pixel_spacing"] = [across, down]
    out["principal_point_offset"] = [off[0] * across, off[1] * down]
    return out
