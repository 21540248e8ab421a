"""Tie points of two real flights: a park by a lake with turned pixels, and bare fields in NIR."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from georef_gis.geodesy import MapFrame, Origin, map_crs
from georef_gis.ingest.photos import find_photos, read_photos
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.pose import Mount
from georef_gis.model.terrain import Terrain
from georef_gis.orient.direct import DirectSettings, direct_poses
from georef_gis.orient.heights import GroundSetting, solve_heights
from georef_gis.orient.ties import TieResult, TieSettings, find_ties

# Smaller than by default, for the time it takes.
SETTINGS = TieSettings(max_side=1400, max_features=3500)


def oriented(name: str) -> tuple[list[OrientedPhoto], Terrain]:
    folder = os.environ.get("GEOREF_DATA")
    if not folder:
        pytest.skip("GEOREF_DATA is not set: no real data")
    read = read_photos(find_photos(Path(folder) / name / "photos"))
    photos = sorted(read.photos, key=lambda p: p.id)
    tags = [p.geotag for p in photos if p.geotag is not None]
    lat, lon = (float(np.median([getattr(t, axis) for t in tags])) for axis in ("lat", "lon"))
    origin = Origin(lat=lat, lon=lon, height_ellipsoidal=200.0)
    heights = solve_heights(photos, origin, GroundSetting())
    found = direct_poses(
        photos,
        origin,
        heights,
        Mount(),
        DirectSettings(),
        convergence_at=MapFrame(origin, map_crs("EPSG:32617")).convergence_at,
    )
    return [
        OrientedPhoto(photo=p, camera=read.cameras[p.camera_id], pose=f.pose)
        for p, f in zip(photos, found, strict=True)
        if f.pose is not None
    ], heights.terrain


def assert_rays_meet(photos: list[OrientedPhoto], result: TieResult) -> None:
    """Matches of pairs obey a relative pose that another solver finds from half of them."""
    ties, where = result.ties, {p.id: i for i, p in enumerate(photos)}
    shares = []
    for pair in sorted(result.pairs, key=lambda p: -p.inliers)[:12]:
        a, b = (where[name] for name in pair.ids)
        uv = [dict(zip(ties.point[m].tolist(), ties.uv[m], strict=True))
              for m in (ties.photo == a, ties.photo == b)]  # fmt: skip
        both = sorted(uv[0].keys() & uv[1].keys())
        p, q = (
            photos[i].camera.ray(np.array([uv[k][n] for n in both])) for k, i in enumerate((a, b))
        )
        p, q = p[:, :2] / p[:, 2:], q[:, :2] / q[:, 2:]
        # Classic five points and RANSAC, not the solver of the product.
        pixel = 1.0 / photos[a].camera.fx
        E, _ = cv2.findEssentialMat(p[::2], q[::2], np.eye(3), cv2.RANSAC, 0.999, 2.0 * pixel)
        x, y = (np.hstack([v[1::2], np.ones((len(v[1::2]), 1))]) for v in (p, q))
        line = x @ E[:3].T
        distance = np.abs(np.sum(y * line, axis=1)) / np.hypot(line[:, 0], line[:, 1])
        shares.append(np.mean(distance < 6.0 * pixel))
    assert np.mean(shares) > 0.9


@pytest.mark.slow
def test_brighton_beach_hangs_together_and_its_six_turned_photos_are_found() -> None:
    photos, terrain = oriented("brighton_beach")
    result = find_ties(photos, terrain, SETTINGS)
    assert [len(c) for c in result.components] == [18]
    assert np.bincount(result.ties.photo, minlength=18).min() >= 150
    turned = {p: t.quarter_deg for p, t in result.turns.items() if t.is_change}
    assert turned == {f"DJI_{n:04d}": 180 for n in range(24, 30)}
    assert_rays_meet(photos, result)


@pytest.mark.slow
def test_seneca16_hangs_together_and_its_courses_are_mended() -> None:
    photos, terrain = oriented("seneca16")
    result = find_ties(photos, terrain, SETTINGS)
    assert [len(c) for c in result.components] == [16]
    assert np.bincount(result.ties.photo, minlength=16).min() >= 150
    assert {t.quarter_deg for t in result.turns.values()} == {0}
    # Heading is a course: the crab shows, and is known to a few degrees.
    yaw = np.degrees([t.yaw for t in result.turns.values()])
    assert all(t.correct for t in result.turns.values())
    assert np.ptp(yaw) > 10.0
    assert np.abs(yaw).max() < 40.0
    assert_rays_meet(photos, result)
