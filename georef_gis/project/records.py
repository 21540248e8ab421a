"""Rows of the project database from the values of the model, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import (
    R_BODY_FROM_CAM_NADIR,
    R_PHOTO_FROM_CAM,
    Array,
    R_enu_from_ned,
    R_map_from_enu,
    opk_from_R_map_from_photo,
    rpy_from_R_ned_from_body,
)
from georef_gis.geodesy import Datum, Height, HeightKind, MapFrame, Origin, parse_crs
from georef_gis.model.camera import PARAMETERS, Camera
from georef_gis.model.layers import Footprint
from georef_gis.model.photo import AttitudeTag, Geotag, Photo
from georef_gis.model.pose import Pose
from georef_gis.project.database import Database, Row, Srs
from georef_gis.project.geometry import point_wkb, polygon_wkb

_UPPER = np.triu_indices(6)
_ANGLES = ("roll", "pitch", "yaw", "sigma_roll_pitch", "sigma_yaw", "vehicle_yaw")
_PLAIN = ("height_above_takeoff", "height_above_ground", "course", "ground_speed")


# -- the frame of the project ------------------------------------------------------------------


def save_frame(database: Database, frame: MapFrame) -> None:
    """Fix the project's origin, CRS and datums; features of another CRS are dropped."""
    # The z of its features is in metres, of kinds that their columns tell: no vertical part.
    crs = frame.horizontal
    database.set_crs(Srs(name=crs.name, wkt=crs.to_wkt("WKT1_GDAL"), code=crs.to_epsg()))
    o = frame.origin
    database.set_meta(
        origin=[math.degrees(o.lat), math.degrees(o.lon), o.height_ellipsoidal],
        crs=frame.crs.to_wkt(),
        datum={"gnss": str(frame.gnss_datum), "output": str(frame.crs_datum)},
    )


def load_frame(database: Database) -> MapFrame:
    """Frame that `save_frame` fixed.

    Raises
    ------
    InputError
        If no photos were read yet.
    """
    origin, crs, datum = (database.meta(key) for key in ("origin", "crs", "datum"))
    if origin is None or crs is None:
        raise InputError("no photos were read yet; run `georef run`", source=str(database.path))
    return MapFrame(
        Origin(
            lat=math.radians(origin[0]), lon=math.radians(origin[1]), height_ellipsoidal=origin[2]
        ),
        parse_crs(crs),
        gnss_datum=Datum.parse(datum["gnss"]),
        crs_datum=Datum.parse(datum["output"]),
    )


# -- photos ------------------------------------------------------------------------------------


def photo_row(photo: Photo, frame: MapFrame, *, status: str, fingerprint: str) -> Row:
    """Row of table `photo`; the point is the tagged position, z the tag's height as it is."""
    tags: dict[str, Any] = {key: getattr(photo, key) for key in _PLAIN}
    tags |= {"make": photo.make, "model": photo.model, "software": photo.software}
    tags |= {"bands": photo.bands, "raw": dict(photo.tags)}
    geom = None
    if photo.geotag is not None:
        tags["geotag"] = _geotag_json(photo.geotag)
        height = photo.geotag.height.value if photo.geotag.height else math.nan
        e, n, _ = frame.map_from_geo([photo.geotag.lat, photo.geotag.lon, 0.0])
        geom = point_wkb(float(e), float(n), height)
    if photo.attitude is not None:
        tags["attitude"] = _attitude_json(photo.attitude)
    return {
        "photo_id": photo.id,
        "flight_id": photo.flight_id,
        "camera_id": photo.camera_id,
        "mount_id": photo.mount_id,
        "name": photo.path.name,
        "path": str(photo.path),
        "width": photo.width,
        "height": photo.height,
        "camera_clock": photo.camera_clock.isoformat() if photo.camera_clock else None,
        "clock_resolution_s": photo.clock_resolution_s,
        "time_gps": photo.time_gps,
        "time_sigma_s": photo.time_sigma,
        "time_source": photo.time_source,
        "match_confidence": photo.match_confidence,
        "fingerprint": fingerprint,
        "tags": tags,
        "status": status,
        "doubts": list(photo.doubts),
        "geom": geom,
    }


def photo_of(row: Mapping[str, Any]) -> Photo:
    """Photo of a row of table `photo`."""
    tags = row["tags"] or {}
    clock = row["camera_clock"]
    return Photo(
        id=row["photo_id"],
        path=Path(row["path"]),
        width=row["width"],
        height=row["height"],
        camera_id=row["camera_id"],
        flight_id=row["flight_id"],
        mount_id=row["mount_id"],
        bands=tags.get("bands", 3),
        camera_clock=datetime.fromisoformat(clock) if clock else None,
        clock_resolution_s=row["clock_resolution_s"],
        time_gps=row["time_gps"],
        time_sigma=row["time_sigma_s"],
        time_source=row["time_source"] or "",
        match_confidence=row["match_confidence"],
        geotag=_geotag_of(tags.get("geotag")),
        attitude=_attitude_of(tags.get("attitude")),
        make=tags.get("make", ""),
        model=tags.get("model", ""),
        software=tags.get("software", ""),
        tags=tags.get("raw", {}),
        doubts=tuple(row["doubts"] or ()),
        **{key: tags.get(key) for key in _PLAIN},
    )


def _geotag_json(tag: Geotag) -> dict[str, Any]:
    out = {"lat_deg": math.degrees(tag.lat), "lon_deg": math.degrees(tag.lon)}
    rest = {key: getattr(tag, key) for key in ("sigma_h", "sigma_v", "of", "datum", "source")}
    height = tag.height and {**asdict(tag.height), "kind": tag.height.kind.value}
    return out | rest | {"height": height}


def _geotag_of(d: Mapping[str, Any] | None) -> Geotag | None:
    if d is None:
        return None
    h = d["height"]
    height = Height(value=h["value"], kind=HeightKind(h["kind"]), geoid=h["geoid"]) if h else None
    return Geotag(
        lat=math.radians(d["lat_deg"]),
        lon=math.radians(d["lon_deg"]),
        height=height,
        sigma_h=d["sigma_h"],
        sigma_v=d["sigma_v"],
        of=d["of"],
        datum=d["datum"],
        source=d["source"],
    )


def _attitude_json(tag: AttitudeTag) -> dict[str, Any]:
    angles = {key: getattr(tag, key) for key in _ANGLES}
    degrees = {f"{k}_deg": None if v is None else math.degrees(v) for k, v in angles.items()}
    return {"dialect": tag.dialect, "yaw_is_course": tag.yaw_is_course, **degrees}


def _attitude_of(d: Mapping[str, Any] | None) -> AttitudeTag | None:
    if d is None:
        return None
    values = {k: None if (v := d[f"{k}_deg"]) is None else math.radians(v) for k in _ANGLES}
    return AttitudeTag(dialect=d["dialect"], yaw_is_course=d["yaw_is_course"], **values)  # type: ignore[arg-type]


# -- cameras -----------------------------------------------------------------------------------

_CAMERA_EXTRA = ("k4", "poly", "sigma_f", "sigma_c", "notes")


def camera_row(camera: Camera, *, name: str = "") -> Row:
    """Row of table `camera`."""
    return {
        "camera_id": camera.id,
        "name": name or camera.id,
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "parameters": camera.parameters.tolist(),
        "covariance": None,
        "readout_s": camera.readout_s,
        "source": camera.source,
        "extra": {key: getattr(camera, key) for key in _CAMERA_EXTRA},
    }


def camera_of(row: Mapping[str, Any]) -> Camera:
    """Camera of a row of table `camera`."""
    extra = {k: v for k, v in (row["extra"] or {}).items() if k in _CAMERA_EXTRA}
    return Camera(
        id=row["camera_id"],
        width=row["width"],
        height=row["height"],
        model=row["model"],
        readout_s=row["readout_s"] or 0.0,
        source=row["source"] or "",
        poly=tuple(extra.pop("poly", ())),
        notes=tuple(extra.pop("notes", ())),
        **dict(zip(PARAMETERS, row["parameters"], strict=True)),
        **extra,
    )


# -- poses -------------------------------------------------------------------------------------


def pose_row(
    photo_id: str,
    pose: Pose,
    frame: MapFrame,
    *,
    height_above_ground: float,
    dialect: str,
    doubts: Sequence[str],
    turned_deg: int = 0,
) -> Row:
    """Row of table `pose`: the pose itself, and its angles for people.

    Omega, phi, kappa are those of the map; roll, pitch, yaw those of a vehicle whose camera looks
    down, at the photo's own place. `sigma_v_m` is that of the height above the ellipsoid,
    `sigma_height_over_ground_m` in `extra` that of the camera over the ground.
    """
    angles = pose_angles(pose, frame)
    p_map = frame.map_from_enu(pose.origin_enu)
    c = pose.covariance
    return {
        "photo_id": photo_id,
        "kind": pose.kind,
        "x_enu": float(pose.origin_enu[0]),
        "y_enu": float(pose.origin_enu[1]),
        "z_enu": float(pose.origin_enu[2]),
        "rotation": pose.R_enu_from_cam.ravel().tolist(),
        "covariance": c[_UPPER].tolist(),
        **{key: math.degrees(value) for key, value in angles.items()},
        "sigma_h_m": float(np.sqrt((c[0, 0] + c[1, 1]) / 2)),
        "sigma_v_m": pose.sigma_height,
        "height_above_ground_m": height_above_ground,
        "dialect": dialect,
        "status": "doubtful" if doubts else "ok",
        "doubts": list(doubts),
        "extra": {"turned_deg": turned_deg, **_motion_json(pose), **_height_json(pose)},
        "geom": point_wkb(*(float(v) for v in p_map)),
    }


def _motion_json(pose: Pose) -> dict[str, Any]:
    motion = {"velocity_enu": pose.velocity_enu, "rate_enu": pose.rate_enu}
    return {key: value.tolist() for key, value in motion.items() if value is not None}


def _height_json(pose: Pose) -> dict[str, Any]:
    return {
        "height_kind": pose.height_kind,
        "sigma_height_absolute_m": pose.sigma_height,
        "sigma_height_over_ground_m": float(np.sqrt(pose.covariance[2, 2])),
        "sigma_height_shared_m": pose.sigma_height_shared,
    }


def pose_angles(pose: Pose, frame: MapFrame) -> dict[str, float]:
    """omega_deg .. roll_deg as keys, values in rad."""
    lat, lon, _ = frame.origin.geo_from_enu(pose.origin_enu)
    R_enu_ned = R_enu_from_ned(frame.origin.lat, frame.origin.lon, lat, lon)
    R_ned_body = R_enu_ned.T @ pose.R_enu_from_cam @ R_BODY_FROM_CAM_NADIR.T
    roll, pitch, yaw = rpy_from_R_ned_from_body(R_ned_body)
    R_local_enu = R_enu_from_ned(0.0, 0.0, 0.0, 0.0) @ R_enu_ned.T
    R_map = R_map_from_enu(frame.convergence_at(pose.origin_enu)) @ R_local_enu
    omega, phi, kappa = opk_from_R_map_from_photo(R_map @ pose.R_enu_from_cam @ R_PHOTO_FROM_CAM.T)
    return {
        "omega_deg": float(omega), "phi_deg": float(phi), "kappa_deg": float(kappa),
        "yaw_deg": float(yaw) % (2 * math.pi), "pitch_deg": float(pitch), "roll_deg": float(roll),
    }  # fmt: skip


def pose_of(row: Mapping[str, Any]) -> Pose:
    """Pose of a row of table `pose`."""
    covariance = np.zeros((6, 6))
    covariance[_UPPER] = row["covariance"]
    covariance = covariance + np.triu(covariance, 1).T
    extra = row["extra"] or {}
    motion = {key: np.array(extra[key]) for key in ("velocity_enu", "rate_enu") if extra.get(key)}
    return Pose(
        origin_enu=np.array([row["x_enu"], row["y_enu"], row["z_enu"]]),
        R_enu_from_cam=np.array(row["rotation"]).reshape(3, 3),
        covariance=covariance,
        kind=row["kind"],
        sigma_height_shared=extra.get("sigma_height_shared_m", 0.0),
        height_kind=extra.get("height_kind", ""),
        **motion,
    )


# -- footprints --------------------------------------------------------------------------------


def footprint_row(footprint: Footprint, *, pose_kind: str, doubts: Sequence[str]) -> Row:
    """Row of table `footprint`."""
    ring: list[tuple[float, float]] = [(float(x), float(y)) for x, y in footprint.ring_map]
    return {
        "photo_id": footprint.photo_id,
        "pose_kind": pose_kind,
        "gsd_m": footprint.gsd,
        "area_m2": footprint.area_m2,
        "tilt_deg": math.degrees(footprint.tilt),
        "sigma_m": footprint.sigma_horizontal,
        "status": "doubtful" if doubts else "ok",
        "doubts": list(doubts),
        "extra": {
            "gsd_min_m": footprint.gsd_min,
            "gsd_max_m": footprint.gsd_max,
            "height_above_ground_m": footprint.height_above_ground,
            "clipped": footprint.clipped,
            "nadir_map": footprint.nadir_map.tolist(),
            "ring_map": footprint.ring_map.tolist(),
            "ring_enu": footprint.ring_enu.tolist(),
        },
        "geom": polygon_wkb(ring),
    }


def footprint_of(row: Mapping[str, Any]) -> Footprint:
    """Footprint of a row of table `footprint`."""
    extra = row["extra"]

    def array(key: str) -> Array:
        return np.array(extra[key], dtype=np.float64)

    return Footprint(
        photo_id=row["photo_id"],
        ring_map=array("ring_map"),
        ring_enu=array("ring_enu"),
        gsd=row["gsd_m"],
        gsd_min=extra["gsd_min_m"],
        gsd_max=extra["gsd_max_m"],
        area_m2=row["area_m2"],
        height_above_ground=extra["height_above_ground_m"],
        tilt=math.radians(row["tilt_deg"]),
        nadir_map=array("nadir_map"),
        sigma_horizontal=row["sigma_m"],
        clipped=extra["clipped"],
    )
