"""A flight folder: photos, logs, control, DEM, and the truth beside them."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from georef_gis.simulate import elevation, ellipsoid, flight_log, site
from georef_gis.simulate.flight import (
    LOCAL_FROM_UTC,
    NOMINAL_BODY_FROM_CAM,
    SimulatedFlight,
    map_from_ecef,
)
from georef_gis.simulate.jpeg_tags import encode_jpeg
from georef_gis.units import week_from_gps

Row = Sequence[str | int]


def write_flight(
    flight: SimulatedFlight,
    folder: Path,
    *,
    photos: Iterable[int] | None = None,
    truth_imu: bool = False,
    quality: int = 85,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Path, ...]:
    """Write a flight folder and return its files.

    Parameters
    ----------
    flight
        From `simulate_flight`.
    folder
        Made if missing; files of the same names are replaced.
    photos
        Indices of the photos to render, all by default; () renders none.
    truth_imu
        Also write ``truth/imu.csv``, about 1 MB.
    quality
        JPEG quality.
    progress
        Called with the share done and a message after each photo.
    """
    for name in ("photos", "logs", "control", "truth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    written = [
        *flight_log.write_logs(flight, folder, truth_imu=truth_imu),
        *_write_control(flight, folder),
        *_write_truth(flight, folder),
        *elevation.write_dem(flight, folder),
    ]
    chosen = range(len(flight.names)) if photos is None else list(photos)
    for done, index in enumerate(chosen, start=1):
        written.append(_write_photo(flight, folder, index, quality))
        if progress is not None:
            progress(done / len(chosen), flight.names[index])
    return tuple(written)


def _write_photo(flight: SimulatedFlight, folder: Path, index: int, quality: int) -> Path:
    from georef_gis.simulate.render import render_photo

    path = folder / "photos" / flight.names[index]
    path.write_bytes(encode_jpeg(flight, index, render_photo(flight, index), quality=quality))
    return path


def write_rows(path: Path, header: Row, rows: Iterable[Row], *, comments: Row = ()) -> Path:
    """A comma-separated table, after lines that begin with ``#``."""
    with path.open("w", encoding="utf-8", newline="") as out:
        out.writelines(f"# {line}\n" for line in comments)
        table = csv.writer(out, lineterminator="\n")
        table.writerow(header)
        table.writerows(rows)
    return path


def write_json(path: Path, values: dict[str, object]) -> Path:
    """Indented JSON with a newline at its end."""
    path.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
    return path


CONTROL_COMMENTS = (
    f"crs: {site.OUTPUT_CRS}",
    f"datum: {site.DATUM}",
    "height_kind: orthometric",
    "geoid: EGM96",
    "unit: US survey foot (easting, northing, height); sigmas in m",
)
CONTROL_COLUMNS = ("name", "easting", "northing", "height", "sigma_h_m", "sigma_v_m", "role")


def _write_control(flight: SimulatedFlight, folder: Path) -> list[Path]:
    settings = flight.settings
    sigmas = (f"{settings.control_sigma_h:.3f}", f"{settings.control_sigma_v:.3f}")
    surveyed = [
        (p.name, f"{p.easting:.4f}", f"{p.northing:.4f}", f"{p.height_orthometric:.4f}", *sigmas,
         p.role)
        for p in flight.control
    ]  # fmt: skip
    true = []
    for p in flight.control:
        e, n, height = map_from_ecef(p.p_ecef)
        true.append((p.name, f"{e:.4f}", f"{n:.4f}", f"{height:.4f}", "0", "0", p.role))
    marks = [
        (m.point, flight.names[m.photo], *(f"{c:.3f}" for c in m.uv), f"{settings.mark_sigma:.2f}")
        for m in flight.marks
    ]
    true_marks = [
        (m.point, flight.names[m.photo], *(f"{c:.4f}" for c in m.uv_true), "0")
        for m in flight.marks
    ]
    columns = ("name", "photo", "u", "v", "sigma_px")
    control, truth = folder / "control", folder / "truth"
    return [
        write_rows(control / "control.csv", CONTROL_COLUMNS, surveyed, comments=CONTROL_COMMENTS),
        write_rows(truth / "control.csv", CONTROL_COLUMNS, true, comments=CONTROL_COMMENTS),
        write_rows(control / "marks.csv", columns, marks),
        write_rows(truth / "marks.csv", columns, true_marks),
    ]


def _write_truth(flight: SimulatedFlight, folder: Path) -> list[Path]:
    truth = folder / "truth"
    return [
        _write_poses(flight, truth / "poses.csv"),
        _write_objects(truth / "objects.csv"),
        _write_triggers(flight, truth / "triggers.csv"),
        write_json(truth / "camera.json", _camera(flight)),
        write_json(truth / "mount.json", _mount(flight)),
        write_json(truth / "clock.json", _clock(flight)),
    ]


def _write_poses(flight: SimulatedFlight, path: Path) -> Path:
    axes = [f"{i}{j}" for i in range(3) for j in range(3)]
    header = (
        "photo", "gps_week", "tow_s", "lat_deg", "lon_deg", "height_ellipsoidal_m",
        "height_above_ground_m", "roll_deg", "pitch_deg", "yaw_deg",
        *(f"R_ecef_from_cam_{a}" for a in axes), *(f"R_ned_from_cam_{a}" for a in axes),
    )  # fmt: skip
    lat, lon, h = ellipsoid.geodetic_from_ecef(flight.p_ecef)
    above = h - site.ground_height(lat, lon)
    rpy = np.degrees(flight.states.rpy)
    rows: list[Row] = []
    for i, name in enumerate(flight.names):
        week, tow = week_from_gps(flight.start_gps + float(flight.exposures[i]))
        place = (f"{np.degrees(lat[i]):.10f}", f"{np.degrees(lon[i]):.10f}", f"{h[i]:.4f}")
        angles = (f"{rpy[i, 0]:.6f}", f"{rpy[i, 1]:.6f}", f"{rpy[i, 2] % 360:.6f}")
        matrices = [flight.R_ecef_from_cam[i].ravel(), flight.R_ned_from_cam[i].ravel()]
        numbers = [f"{x:.12f}" for x in np.concatenate(matrices)]
        rows.append((name, week, f"{tow:.6f}", *place, f"{above[i]:.3f}", *angles, *numbers))
    return write_rows(path, header, rows)


def _write_objects(path: Path) -> Path:
    """One row per object, with four rows more for the foot of a building's corners."""
    rows: list[Row] = []
    for item in site.objects():
        feet = [("", item.enu)]
        if item.kind == "building":
            feet += [(f"corner {k + 1}", p) for k, p in enumerate(item.corners(0.0))]
        for part, p in feet:
            lat, lon, h = ellipsoid.geodetic_from_ecef(site.ecef_from_enu(p))
            e, n = ellipsoid.state_plane_from_geodetic(lat, lon)
            rows.append(
                (item.name, item.kind, part, f"{np.degrees(lat):.9f}", f"{np.degrees(lon):.9f}",
                 f"{h:.3f}", f"{e:.3f}", f"{n:.3f}", f"{item.length:.2f}", f"{item.width:.2f}",
                 f"{item.height:.2f}")
            )  # fmt: skip
    header = (
        "name", "kind", "part", "lat_deg", "lon_deg", "height_ellipsoidal_m", "easting_ftus",
        "northing_ftus", "length_m", "width_m", "height_m",
    )  # fmt: skip
    return write_rows(path, header, rows)


def _write_triggers(flight: SimulatedFlight, path: Path) -> Path:
    """Every exposure with the line of the log that belongs to it, and the spurious lines."""
    line_of = {t.photo: k for k, t in enumerate(flight.triggers, start=1) if t.photo is not None}
    events: list[tuple[float, str, str | int]] = [
        (float(t), flight.names[i], line_of.get(i, "missed"))
        for i, t in enumerate(flight.exposures)
    ]
    events += [
        (t.time, "spurious", k) for k, t in enumerate(flight.triggers, start=1) if t.photo is None
    ]
    rows: list[Row] = []
    for time, photo, line in sorted(events, key=lambda event: event[0]):
        week, tow = week_from_gps(flight.start_gps + time)
        rows.append((photo, week, f"{tow:.6f}", line))
    return write_rows(path, ("photo", "gps_week", "tow_s", "seq"), rows)


def _camera(flight: SimulatedFlight) -> dict[str, object]:
    camera = flight.settings.camera
    names = ("width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
    note = "pixels; OpenCV's direction, ideal to distorted; (0, 0) is the centre of the first pixel"
    return {"note": note} | {name: getattr(camera, name) for name in names}


def _mount(flight: SimulatedFlight) -> dict[str, object]:
    return {
        "note": "body is forward, right, down at the IMU; m and rad; "
        "R_body_from_cam = Exp(boresight_body) @ R_body_from_cam_nominal",
        "lever_arm_body_camera": flight.lever_arm_camera.round(6).tolist(),
        "lever_arm_body_antenna": flight.lever_arm_antenna.round(6).tolist(),
        "lever_arm_body_camera_believed": list(flight.settings.lever_arm_camera),
        "lever_arm_body_antenna_believed": list(flight.settings.lever_arm_antenna),
        "lever_arm_sigma": flight.settings.lever_arm_sigma,
        "boresight_body": flight.boresight.round(9).tolist(),
        "boresight_sigma_deg": flight.settings.boresight_sigma_deg,
        "R_body_from_cam_nominal": [list(row) for row in NOMINAL_BODY_FROM_CAM],
    }


def _clock(flight: SimulatedFlight) -> dict[str, object]:
    week, tow = week_from_gps(flight.start_gps)
    return {
        "note": "camera clock = UTC + local_from_utc_s + offset_s + drift * (t - reference), "
        "cut to whole seconds",
        "reference_gps_week": week,
        "reference_tow_s": round(tow, 6),
        "local_from_utc_s": LOCAL_FROM_UTC.total_seconds(),
        "offset_s": round(flight.clock_offset, 6),
        "drift": round(flight.clock_drift, 12),
        "resolution_s": 1.0,
    }
