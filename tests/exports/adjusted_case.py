"""A project with an adjustment: six photos, a calibrated camera beside the first one, points."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from interchange_cases import CAMERAS, make_block_site

from exports.site.site import SiteLayers
from georef_gis.model.camera import Camera
from georef_gis.project import Project
from georef_gis.project.columns_file import write_columns
from georef_gis.project.geometry import point_wkb
from georef_gis.project.records import camera_row, photo_row, pose_row, save_frame

ADJUSTED = "k3 adjusted"
# m and px
POINT_SIGMA = (0.03, 0.04, 0.09)
NOISE = 0.7
# Photo whose pixels an editor had turned, which only the matching found out.
TURNED, DEGREES = 1, 180


def R_quarter(degrees: int) -> np.ndarray:
    """Axes of a picture turned clockwise, from those of the sensor."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return np.linalg.matrix_power(quarter, degrees // 90)


def adjusted_camera(**values: float) -> Camera:
    """The camera of the site after a calibration."""
    old = CAMERAS["k3"]
    new = {"fx": old.fx + 7.0, "fy": old.fy + 7.0, "cx": old.cx + 3.0, "k1": old.k1 - 0.01}
    return replace(old, id=ADJUSTED, source="adjusted", sigma_f=0.4, **{**new, **values})


def save(
    folder: Path, *, camera: Camera | None = None, held: bool = False, degrees: int = DEGREES
) -> tuple[Project, SiteLayers]:
    """Project whose truth the poses, the camera and the points of the site given back are.

    With `held` the photos were adjusted in a pinhole, as those of a fisheye are, and keep their
    camera.
    """
    camera = camera or adjusted_camera()
    site = make_block_site()
    project = Project.create(folder, {"project": {"name": "Site"}})
    project.prepare()
    photos, rows = [], []
    for i, one in enumerate(site.photos):
        turned = degrees if i == TURNED else 0
        stored = one.pose.R_enu_from_cam @ R_quarter(turned).T
        pose = replace(one.pose, R_enu_from_cam=stored, sigma_height_shared=5.0)
        photos.append(replace(one, pose=pose, turned_deg=turned, posed_camera_id=camera.id))
        tags = replace(one.pose, kind="tags", origin_enu=one.pose.origin_enu + 5.0)
        rows.append(_pose(site, one, tags, 0, {}))
        rows.append(_pose(site, one, pose, turned, {} if held else {"camera_id": ADJUSTED}))
    taken = replace(camera, id="k3") if held else CAMERAS["k3"]
    cameras = [camera_row(taken)]
    if not held:
        row = camera_row(camera, name="k3")
        cameras.append({**row, "extra": {**row["extra"], "adjusted_of": "k3"}})
    database = project.database
    with database.transaction():
        save_frame(database, site.frame)
        database.set_meta(
            epoch=site.epoch_gps,
            ground={"kind": "flat", "sigma_m": 1.5, "sigma_shared_m": 12.0},
            ground_adjusted={"kind": "tin", "sigma_m": 0.5, "sigma_shared_m": 0.4},
        )
        database.replace_rows(
            "photo",
            [photo_row(p.photo, site.frame, status="ok", fingerprint="") for p in site.photos],
        )
        database.replace_rows("pose", rows)
        database.replace_rows("camera", cameras)
    truth = replace(site, photos=tuple(photos), cameras=(camera,))
    _save_points(project.adjustment, site, camera, held)
    return project, truth


def _pose(site: SiteLayers, one: Any, pose: Any, turned: int, extra: dict[str, Any]) -> Any:
    row = pose_row(
        one.photo.id, pose, site.frame, height_above_ground=100.0, dialect="adjusted", doubts=(),
        turned_deg=turned,
    )  # fmt: skip
    return {**row, "extra": {**row["extra"], **extra}}


def _save_points(folder: Path, site: SiteLayers, camera: Camera, held: bool) -> None:
    """Points 80 to 120 m below the photos, their noisy pixels in the sensors' axes, one mark."""
    folder.mkdir()
    rng = np.random.default_rng(11)
    places, photo, point, uv, residual = [], [], [], [], []
    used = site.photos[:5]
    for k in range(40):
        first = used[k % 5].pose
        p = first.origin_enu + first.enu_directions(
            camera.ray(rng.uniform([60, 60], [camera.width - 60, camera.height - 60]))
        ) * rng.uniform(300.0, 900.0)
        for i, one in enumerate(used):
            p_cam = one.pose.cam_from_enu(p)
            exact = camera.project(p_cam)
            # well before the camera, as a pinhole has to see it
            ahead = p_cam[2] > 0.4 * np.linalg.norm(p_cam)
            if not (ahead and np.all(np.abs(exact - 320) < 900)):
                continue
            off = rng.normal(0.0, NOISE, 2)
            photo.append(i)
            point.append(len(places))
            uv.append(_adjusted_uv(camera, exact + off, held))
            residual.append(off)
        if point.count(len(places)) < 2:
            n = point.count(len(places))
            del photo[-n:], point[-n:], uv[-n:], residual[-n:]
        else:
            places.append(p)
    n = len(places)
    rms = [
        np.sqrt(np.mean([r**2 for r, j in zip(residual, point, strict=True) if j == i]))
        for i in range(n)
    ]
    write_columns(
        folder / "points.npz", "ground points",
        {
            "p_enu": np.array(places),
            "covariance": np.tile(np.diag(np.square(POINT_SIGMA)), (n, 1, 1)).astype(np.float32),
            "rays": np.bincount(point).astype(np.int32),
            "residual_px": np.array(rms, np.float32),
        },
    )  # fmt: skip
    # a mark of a control point stands behind the tie points
    write_columns(
        folder / "residuals.npz", "residuals",
        {
            "photo_ids": [one.photo.id for one in site.photos],
            "photo": np.array([*photo, 0], np.int32),
            "point": np.array([*point, n], np.int32),
            "uv": np.array([*uv, [5.0, 5.0]], np.float32),
            "residual": np.array([*residual, [0.0, 0.0]], np.float32),
            "sigma": np.ones(len(photo) + 1, np.float32),
            "mark": np.array([-1] * len(photo) + [0]),
        },
    )  # fmt: skip
    report = {
        "photos": [
            {"photo": one.photo.id, "observations": photo.count(i), "rms_px": 0.5 + i}
            for i, one in enumerate(site.photos)
        ],
        "control": [
            {
                "name": "GCP <1>", "role": "check", "off_m": [0.01, -0.02, None],
                "sigma_m": [0.011, 0.012, 0.05], "survey_sigma_m": [0.02, 0.02, None],
                "rays": 3, "rms_px": 0.4,
            }
        ],
    }  # fmt: skip
    (folder / "report.json").write_text(json.dumps(report))


def _adjusted_uv(camera: Camera, uv: np.ndarray, held: bool) -> np.ndarray:
    if not held:
        return uv
    d = camera.ray(uv)
    return 1000.0 * d[:2] / d[2]


def add_control(project: Project, site: SiteLayers) -> None:
    """Two surveyed points, one of them without a height, and marks of the first."""
    database = project.database
    places: Sequence[tuple[str, str, list[float]]] = (
        ("GCP <1>", "check", [10.0, 20.0, -30.0]),
        ("GCP 2", "off", [30.0, 20.0, -30.0]),
    )
    rows = []
    for name, role, p_enu in places:
        e, n, h = (float(v) for v in site.frame.map_from_enu(p_enu))
        rows.append(
            {
                "name": name, "role": role, "sigma_h_m": 0.02, "sigma_v_m": 0.03,
                "datum": "NAD83(2011)@2010.0",
                "geom": point_wkb(e, n, float("nan") if role == "off" else h),
            }
        )  # fmt: skip
    database.replace_rows("control", rows)
    database.replace_rows(
        "mark",
        [
            {"name": "GCP <1>", "photo_id": one.photo.id, "u": 1.0, "v": 2.0, "sigma_px": 0.5}
            for one in site.photos[:3]
        ],
    )
