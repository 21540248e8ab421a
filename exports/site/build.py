"""From poses and footprints to the attributes and positions of the exported layers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np

from exports.site import schemas
from exports.site.columns import Layer, Places
from exports.site.schemas import Value
from exports.site.values import SitePhoto, SiteValues
from georef_gis.frames import (
    R_BODY_FROM_CAM_NADIR,
    R_PHOTO_FROM_CAM,
    Array,
    R_ecef_from_enu,
    R_ecef_from_ned,
    R_map_from_enu,
    jacobian_theta_map_from_opk,
    jacobian_theta_ned_from_rpy,
    opk_from_R_map_from_photo,
    rpy_from_R_ned_from_body,
)
from georef_gis.geodesy import MapFrame, geoid_undulation
from georef_gis.model.photo import Photo
from georef_gis.model.pose import Pose
from georef_gis.units import utc_from_gps

# A flight is split where the time between photos is longer than this ...
GAP_S = 10.0
# ... and than this many times the usual one.
GAP_FACTOR = 5.0


def build_layers(site: SiteValues) -> dict[str, Layer]:
    """Layers of photos and cameras by name."""
    gsd = {f.photo_id: f.gsd for f in site.footprints}
    geo = photo_positions(site.frame, site.photos)
    placed = [i for i in range(len(site.photos)) if np.all(np.isfinite(geo[i, :2]))]
    photos, geo = [site.photos[i] for i in placed], geo[placed]
    points = place(site.frame, geo)
    convergence = grid_convergence(site.frame, geo)
    rows = [
        _photo_values(site, p, points[i : i + 1], gsd.get(p.photo.id), float(convergence[i]))
        for i, p in enumerate(photos)
    ]
    return {
        "photos": Layer.of_rows(
            "photos", "Photos", "Point", schemas.PHOTO_FIELDS, rows, Places.of_points(points)
        ),
        "footprints": _footprints(site),
        "track": _track(site, photos, points),
        "cameras": _cameras(site),
    }


# -- places -------------------------------------------------------------------------------------


def photo_positions(frame: MapFrame, photos: Sequence[SitePhoto]) -> Array:
    """Lat, lon in rad, ellipsoidal height in m of photos; NaN where not known; (n, 3)."""
    out = np.full((len(photos), 3), np.nan)
    for i, p in enumerate(photos):
        if p.pose is not None:
            out[i] = frame.origin.geo_from_enu(p.pose.origin_enu)
        elif p.photo.geotag is not None:
            out[i, :2] = p.photo.geotag.lat, p.photo.geotag.lon
    return out


def place(frame: MapFrame, geo: Array) -> Array:
    """Columns lon deg, lat deg, h ellipsoidal, H orthometric, easting, northing; (n, 6).

    `geo` is lat, lon in rad and ellipsoidal height in m, NaN if not known; (n, 3).
    """
    known = np.where(np.isfinite(geo[:, 2]), geo[:, 2], 0.0)
    p_map = frame.map_from_geo(np.column_stack([geo[:, :2], known]))
    orthometric = geo[:, 2] - geoid_undulation(geo[:, 0], geo[:, 1])
    lonlat = np.degrees(geo[:, 1::-1])
    return np.column_stack([lonlat, geo[:, 2], orthometric, p_map[:, :2]])


def grid_convergence(frame: MapFrame, geo: Array) -> Array:
    """Meridian convergence, rad, at lat, lon: where true north points on the map; (n,)."""
    # rad, about 60 m: short against the curvature of meridians on a map, long against rounding
    step = np.array([1e-5, 0.0, 0.0])
    level = np.column_stack([geo[:, :2], np.zeros(len(geo))])
    north = frame.map_from_geo(level + step) - frame.map_from_geo(level - step)
    return np.asarray(-np.arctan2(north[:, 0], north[:, 1]))


def parts_of(parts: Sequence[Array]) -> Places:
    """Places of features whose vertices `place` gave one by one."""
    if not parts:
        return Places.none(0)
    offsets = np.concatenate([[0], np.cumsum([len(part) for part in parts])])
    return Places.of_points(np.vstack(parts), offsets)


# -- photos -------------------------------------------------------------------------------------


def number(value: float | None) -> float | None:
    """A number for a table: NaN is a missing one."""
    return None if value is None or not math.isfinite(value) else float(value)


def _photo_values(
    site: SiteValues, p: SitePhoto, point: Array, gsd: float | None, convergence: float
) -> dict[str, Value]:
    photo = p.photo
    lon, lat, h, big_h = point[0, :4]
    values: dict[str, Value] = dict.fromkeys(f.name for f in schemas.PHOTO_FIELDS)
    values |= {
        "photo": photo.id,
        "file": photo.path.name,
        "flight": photo.flight_id,
        "camera": p.camera_id,
        "time_utc": _iso(_utc(photo, site.epoch_gps)),
        "camera_clock": photo.camera_clock.isoformat() if photo.camera_clock else None,
        "lon_deg": float(lon),
        "lat_deg": float(lat),
        "height_ellipsoidal_m": number(h),
        "height_orthometric_m": number(big_h),
        "height_above_ground_m": number(p.height_above_ground),
        "sigma_above_ground_m": number(p.sigma_above_ground),
        "gsd_m": number(gsd),
        "tie_points": p.tie_points,
        "residual_px": number(p.residual_px),
        "doubts": "; ".join((*photo.doubts, *p.doubts)) or None,
    }
    if p.pose is not None:
        values["turned_deg"] = p.turned_deg
        values |= _pose_values(
            site.frame, p.pose, math.radians(lat), math.radians(lon), convergence
        )
    return values


def _pose_values(
    frame: MapFrame, pose: Pose, lat: float, lon: float, convergence: float
) -> dict[str, Value]:
    """Angles, their sigmas and those of the position of one pose."""
    R_ned_from_enu = R_ecef_from_ned(lat, lon).T @ frame.origin.R_ecef_from_enu
    R_local_from_enu = R_ecef_from_enu(lat, lon).T @ frame.origin.R_ecef_from_enu
    R_grid_from_enu = R_map_from_enu(convergence) @ R_local_from_enu
    R_enu_from_cam = pose.R_enu_from_cam
    rpy = rpy_from_R_ned_from_body(R_ned_from_enu @ R_enu_from_cam @ R_BODY_FROM_CAM_NADIR.T)
    opk = opk_from_R_map_from_photo(R_grid_from_enu @ R_enu_from_cam @ R_PHOTO_FROM_CAM.T)
    cov_theta = pose.covariance[3:, 3:]
    sigma_rpy = _angle_sigmas(jacobian_theta_ned_from_rpy(*rpy), R_ned_from_enu, cov_theta)
    sigma_opk = _angle_sigmas(jacobian_theta_map_from_opk(*opk), R_grid_from_enu, cov_theta)
    roll, pitch, yaw = np.degrees(rpy)
    names = ("roll", "pitch", "yaw", "omega", "phi", "kappa")
    angles = (roll, pitch, yaw % 360.0, *np.degrees(opk))
    values: dict[str, Value] = {
        f"{name}_deg": float(angle) for name, angle in zip(names, angles, strict=True)
    }
    sigmas = (*sigma_rpy, *sigma_opk)
    values |= {
        f"sigma_{name}_deg": number(math.degrees(sigma))
        for name, sigma in zip(names, sigmas, strict=True)
    }
    cov = R_local_from_enu @ pose.covariance[:3, :3] @ R_local_from_enu.T
    view = (R_local_from_enu @ R_enu_from_cam)[:, 2]
    tilt = math.atan2(math.hypot(view[0], view[1]), -view[2])
    values |= {"pose_kind": pose.kind, "tilt_deg": math.degrees(tilt)}
    values |= {"height_kind": pose.height_kind or None}
    # The ground shares a part of the height's error, which the pose's covariance leaves out.
    up = math.hypot(math.sqrt(max(float(cov[2, 2]), 0.0)), pose.sigma_height_shared)
    return values | _ellipse(cov) | {"sigma_u_m": up}


def _angle_sigmas(J: Array, R: Array, cov_enu: Array) -> Array:
    """One sigma of three angles, rad, from the covariance of the rotation error; NaN at lock."""
    if abs(float(np.linalg.det(J))) < 1e-6:
        return np.full(3, np.nan)
    K = np.linalg.solve(J, R)
    return np.asarray(np.sqrt(np.maximum(np.diag(K @ cov_enu @ K.T), 0.0)))


def _ellipse(cov: Array) -> dict[str, Value]:
    """Sigmas and the one-sigma ellipse of a position from its covariance in east, north, up."""
    sigma = np.sqrt(np.maximum(np.diag(cov), 0.0))
    product = float(sigma[0] * sigma[1])
    small, large = np.linalg.eigvalsh(cov[:2, :2])
    # Azimuth from north of the major axis: half the angle of (2 cov_en, var_n - var_e).
    round_ = large - small <= 1e-9 * max(float(large), 1e-30)
    azimuth = math.degrees(0.5 * math.atan2(2.0 * cov[0, 1], cov[1, 1] - cov[0, 0])) % 180.0
    return {
        "sigma_e_m": float(sigma[0]),
        "sigma_n_m": float(sigma[1]),
        "sigma_u_m": float(sigma[2]),
        "corr_en": float(cov[0, 1]) / product if product > 0 else None,
        "sigma_major_m": math.sqrt(max(float(large), 0.0)),
        "sigma_minor_m": math.sqrt(max(float(small), 0.0)),
        "sigma_azimuth_deg": None if round_ else azimuth,
    }


def _utc(photo: Photo, epoch_gps: float) -> datetime | None:
    return None if photo.time_gps is None else utc_from_gps(epoch_gps + photo.time_gps)


def _iso(instant: datetime | None) -> str | None:
    if instant is None:
        return None
    # a sync board counts microseconds; what is whole stays short
    digits = "microseconds" if instant.microsecond % 1000 else "milliseconds"
    return instant.isoformat(timespec=digits).replace("+00:00", "Z")


# -- footprints, track, cameras -----------------------------------------------------------------


def _footprints(site: SiteValues) -> Layer:
    rows: list[dict[str, Value]] = [
        {
            "photo": f.photo_id,
            "gsd_m": number(f.gsd),
            "gsd_min_m": number(f.gsd_min),
            "gsd_max_m": number(f.gsd_max),
            "area_m2": number(f.area_m2),
            "height_above_ground_m": number(f.height_above_ground),
            "tilt_deg": number(math.degrees(f.tilt)),
            "sigma_horizontal_m": number(f.sigma_horizontal),
            "clipped": f.clipped,
        }
        for f in site.footprints
    ]
    places = parts_of(_footprint_rings(site))
    layer = Layer.of_rows(
        "footprints", "Footprints", "Polygon", schemas.FOOTPRINT_FIELDS, rows, places
    )
    return replace(layer, measured_heights=False)


def _footprint_rings(site: SiteValues) -> list[Array]:
    """Closed rings of the footprints, in the columns of `place`, transformed all at once."""
    rings = [_ring(f.ring_enu) for f in site.footprints]
    if not rings:
        return []
    points = place(site.frame, site.frame.origin.geo_from_enu(np.vstack(rings)))
    parts = np.split(points, np.cumsum([len(ring) for ring in rings])[:-1])
    for f, part in zip(site.footprints, parts, strict=True):
        # The ring on the map is the project's own; the geographic one comes from the same points.
        ring_map = _ring(f.ring_map)
        if len(ring_map) == len(part):
            part[:, 4:] = ring_map[:, :2]
    return [_counter_clockwise(part) for part in parts]


def _ring(points: Array) -> Array:
    return points if np.array_equal(points[0], points[-1]) else np.vstack([points, points[:1]])


def _counter_clockwise(points: Array) -> Array:
    """The same closed ring, counter-clockwise in longitude and latitude."""
    x, y = (points[:, :2] - points[0, :2]).T
    area = float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
    return points if area >= 0 else points[::-1]


def _seconds(photo: Photo) -> float | None:
    """Time within a flight, s, from whatever clock there is."""
    if photo.time_gps is not None:
        return photo.time_gps
    clock = photo.camera_clock
    return None if clock is None else (clock - datetime(2000, 1, 1)).total_seconds()


def _track(site: SiteValues, photos: list[SitePhoto], points: Array) -> Layer:
    """Flights as lines through their photos in order of time."""
    flights: dict[str, list[tuple[float, int]]] = {}
    for i, p in enumerate(photos):
        seconds = _seconds(p.photo)
        if seconds is not None and p.pose is not None:
            flights.setdefault(p.photo.flight_id, []).append((seconds, i))
    rows: list[dict[str, Value]] = []
    lines: list[Array] = []
    for flight, stamps in sorted(flights.items()):
        # One clock per flight: photos without the better time would be sorted at random.
        if any(photos[i].photo.time_gps is not None for _, i in stamps):
            stamps = [(t, i) for t, i in stamps if photos[i].photo.time_gps is not None]
        parts = [part for part in split_at_gaps(sorted(stamps)) if len(part) > 1]
        for number_, part in enumerate(parts, start=1):
            values = _track_values(site, [photos[i].photo for _, i in part])
            index = [i for _, i in part]
            enu = np.array([photos[i].pose.origin_enu for i in index])  # type: ignore[union-attr]
            values |= {
                "flight": flight,
                "part": number_,
                "duration_s": part[-1][0] - part[0][0],
                "length_m": float(np.sum(np.linalg.norm(np.diff(enu, axis=0), axis=1))),
            }
            rows.append(values)
            lines.append(points[index])
    return Layer.of_rows(
        "track", "Flight track", "LineString", schemas.TRACK_FIELDS, rows, parts_of(lines)
    )


def split_at_gaps(stamps: list[tuple[float, int]]) -> list[list[tuple[float, int]]]:
    """Parts of a list of (time in s, what) in order of time, parted where photos are missing."""
    steps = np.diff([t for t, _ in stamps])
    usual = float(np.median(steps)) if steps.size else 0.0
    limit = max(GAP_S, GAP_FACTOR * usual)
    parts: list[list[tuple[float, int]]] = [[]]
    for k, stamp in enumerate(stamps):
        if k and steps[k - 1] > limit:
            parts.append([])
        parts[-1].append(stamp)
    return parts


def _track_values(site: SiteValues, photos: list[Photo]) -> dict[str, Value]:
    return {
        "photos": len(photos),
        "first_photo": photos[0].id,
        "last_photo": photos[-1].id,
        "start_utc": _iso(_utc(photos[0], site.epoch_gps)),
        "end_utc": _iso(_utc(photos[-1], site.epoch_gps)),
    }


def _cameras(site: SiteValues) -> Layer:
    rows = []
    used = [p.camera_id for p in site.photos if p.pose is not None]
    for camera in site.cameras:
        values: dict[str, Value] = {"camera": camera.id, "photos": used.count(camera.id)}
        for f in schemas.CAMERA_FIELDS:
            if f.name not in values:
                values[f.name] = getattr(camera, f.name.removesuffix("_px"))
        rows.append(values)
    return Layer.of_rows("cameras", "Cameras", "None", schemas.CAMERA_FIELDS, rows)
