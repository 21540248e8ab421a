"""Blocks of other programs on the Earth, by the photos' tags or by files beside them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from georef_gis.errors import InputError
from georef_gis.geodesy import Height, HeightKind, Origin, geoid_undulation
from georef_gis.model.camera import Camera
from georef_gis.model.interchange.block import Block, Shot, Similarity
from georef_gis.model.interchange.poses import poses_of_block
from georef_gis.model.photo import AttitudeTag, Geotag, Photo
from georef_gis.orient.placing import place_block

# Across the 180th meridian, south of the equator.
ORIGIN = Origin(lat=math.radians(-17.5), lon=math.radians(179.9995), height_ellipsoidal=150.0)
CAMERA = Camera(id="c", width=64, height=48, fx=50, fy=50, cx=31.5, cy=23.5)


def flight(n: int = 36, *, noise: float = 0.5, seed: int = 1):
    """Truth in enu, the block in a frame of its own, and photos with tags."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-150, 150, n // 3), [-60.0, 0.0, 60.0])
    p = np.column_stack([x.ravel(), y.ravel(), 100 + rng.normal(0, 2, x.size)])
    yaw = np.where(np.arange(len(p)) // (n // 3) % 2, 90.0, 270.0) + rng.normal(0, 5, len(p))
    tilt = rng.normal(0.0, 3.0, (len(p), 2))
    ned_body = Rotation.from_euler("ZYX", np.column_stack([yaw, tilt]), degrees=True).as_matrix()
    enu_ned = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    R = enu_ned @ ned_body @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    Q, scale, shift = Rotation.random(random_state=seed).as_matrix(), 37.0, np.array([5.0, -2, 9])
    shots = tuple(
        Shot(
            name=f"images/IMG_{i}.JPG", camera_id="c", origin=Q.T @ (p[i] - shift) / scale,
            R_world_from_cam=Q.T @ R[i],
        )
        for i in range(len(p))
    )  # fmt: skip
    block = Block(cameras={"c": CAMERA}, shots=shots, source="model")
    seen = p + rng.normal(0.0, noise, p.shape)
    photos = []
    for i, (lat, lon, h) in enumerate(ORIGIN.geo_from_enu(seen)):
        tag = Geotag(
            lat=lat, lon=lon, height=Height(value=h, kind=HeightKind.ELLIPSOIDAL),
            sigma_h=noise, sigma_v=noise,
        )  # fmt: skip
        a, b = np.radians(tilt[i]) + rng.normal(0.0, 0.02, 2)
        attitude = AttitudeTag(dialect="ypr", roll=b, pitch=a, yaw=math.radians(yaw[i]))
        photos.append(
            Photo(id=f"p{i}", path=Path(f"img_{i}.jpg"), width=64, height=48, geotag=tag,
                  attitude=attitude)
        )  # fmt: skip
    return p, R, block, photos


def errors(block: Block, p: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances, m, and angles, deg, from the truth."""
    assert block.origin is not None
    found = ORIGIN.enu_from_ecef(block.origin.ecef_from_enu(block.centres))
    turn = ORIGIN.R_ecef_from_enu.T @ block.origin.R_ecef_from_enu
    angles = [
        math.degrees(Rotation.from_matrix(turn @ s.R_world_from_cam @ r.T).magnitude())
        for s, r in zip(block.shots, R, strict=True)
    ]
    return np.linalg.norm(found - p, axis=1), np.array(angles)


def test_a_block_of_its_own_frame_comes_to_where_the_photos_are() -> None:
    p, R, block, photos = flight()
    placed = place_block(block, photos)
    far, off = errors(placed.block, p, R)
    # 0.5 m over 36 photos and 330 m
    assert far.max() < 0.5
    assert off.max() < 0.3
    assert placed.doubts == ()
    assert placed.block.height_kind == "ellipsoidal"
    poses = poses_of_block(placed.block, "images.txt")
    geotag, attitude = poses["images/IMG_0.JPG"]
    # The error that all positions share stays: 0.5 m.
    assert 0.5 < (geotag.sigma_h or 0.0) < 0.7
    assert attitude.sigma_yaw is not None
    assert abs(math.degrees(geotag.lon)) > 179.99


def test_heights_that_drift_by_100_m_do_not_tilt_it() -> None:
    p, R, block, photos = flight()
    wild = []
    for photo, place in zip(photos, p, strict=True):
        tag = photo.geotag
        height = Height(value=tag.height.value + place[0] / 3.0, kind=HeightKind.ELLIPSOIDAL)
        wild.append(replace(photo, geotag=replace(tag, height=height)))
    placed = place_block(block, wild)
    _, off = errors(placed.block, p, R)
    # 18 deg by the heights; the attitudes are off by 1.1 deg each
    assert off.max() < 1.0
    assert "heights would tilt the block by 18" in placed.doubts[0]


def test_without_attitudes_it_is_laid_as_if_it_looked_down() -> None:
    p, R, block, photos = flight()
    bare = [replace(photo, attitude=None) for photo in photos]
    placed = place_block(block, bare)
    _, off = errors(placed.block, p, R)
    # Good heights over 120 m of width mend the assumption.
    assert off.max() < 1.0
    assert "no photo has an attitude" in placed.doubts[0]
    # A drift of 18 deg is not believed even so.
    drifting = [
        replace(photo, geotag=replace(photo.geotag, height=Height(
            value=photo.geotag.height.value + 0.8 * x, kind=HeightKind.ELLIPSOIDAL)))
        for photo, x in zip(bare, p[:, 0], strict=True)
    ]  # fmt: skip
    _, off = errors(place_block(block, drifting).block, p, R)
    assert off.max() < 3.0


def test_heights_keep_their_kind() -> None:
    p, R, block, photos = flight()
    n = float(geoid_undulation(ORIGIN.lat, ORIGIN.lon))
    orthometric = [
        replace(photo, geotag=replace(photo.geotag, height=Height(
            value=photo.geotag.height.value - n, kind=HeightKind.ORTHOMETRIC)))
        for photo in photos
    ]  # fmt: skip
    placed = place_block(block, orthometric)
    assert placed.block.height_kind == "ellipsoidal"
    assert errors(placed.block, p, R)[0].max() < 0.6
    unknown = [
        replace(photo, geotag=replace(photo.geotag, height=Height(value=99.0 + i % 2,
                                                                  kind=HeightKind.UNKNOWN)))
        for i, photo in enumerate(photos)
    ]  # fmt: skip
    assert place_block(block, unknown).block.height_kind == "unknown"
    none = [replace(photo, geotag=replace(photo.geotag, height=None)) for photo in photos]
    doubts = place_block(block, none).doubts
    assert "no position has a height" in doubts[0]


def test_positions_of_a_file_beside_it_go_before_the_tags() -> None:
    p, R, block, photos = flight(noise=0.02)
    beside = {shot.name: photo.geotag for shot, photo in zip(block.shots, photos, strict=True)}
    wrong = [replace(photo, geotag=replace(photo.geotag, lat=0.5)) for photo in photos]
    placed = place_block(replace(block, positions=beside), wrong)
    assert errors(placed.block, p, R)[0].max() < 0.1


def test_a_block_that_has_its_place_is_left_there() -> None:
    _, _, block, photos = flight()
    own = replace(block, origin=ORIGIN)
    assert place_block(own, photos).block is own


def test_a_block_that_cannot_be_placed_is_refused_by_name() -> None:
    _, _, block, photos = flight()
    with pytest.raises(InputError, match=r"model: .* 2 of its 36 shots have a GPS position"):
        place_block(block, photos[:2])
    swapped = [replace(photo, path=photos[(7 * i) % 36].path) for i, photo in enumerate(photos)]
    with pytest.raises(InputError, match="model: no scale and heading bring more than"):
        place_block(block, swapped[:30])


def test_covariances_move_with_the_block() -> None:
    rng = np.random.default_rng(3)
    R = Rotation.random(random_state=4).as_matrix()
    root = rng.normal(0.0, 1.0, (7, 7)) * ([2e-3] + [2e-3] * 3 + [0.05] * 3)
    how = Similarity(
        scale=30.0, R_to_from=R, shift=np.array([9.0, 8.0, 7.0]), pivot=np.array([1.0, 2.0, 3.0]),
        covariance=root.T @ root,
    )  # fmt: skip
    own = rng.normal(0.0, 1.0, (6, 6)) * 2e-3
    shot = Shot(
        name="a", camera_id="c", origin=np.array([2.0, -1.0, 4.0]),
        R_world_from_cam=Rotation.random(random_state=5).as_matrix(), covariance=own.T @ own,
    )  # fmt: skip
    block = Block(cameras={"c": CAMERA}, shots=(shot,))
    placed = block.placed(how, ORIGIN, HeightKind.ELLIPSOIDAL).shots[0]
    n = 40_000
    e = rng.multivariate_normal(np.zeros(7), how.covariance, n)
    d = rng.multivariate_normal(np.zeros(6), shot.covariance, n)
    turn = Rotation.from_rotvec(e[:, 1:4]) * Rotation.from_matrix(R)
    p = shot.origin + d[:, :3]
    at_pivot = how.apply(how.pivot) + e[:, 4:]
    there = at_pivot + how.scale * (1 + e[:, :1]) * turn.apply(p - how.pivot)
    angles = (
        turn * Rotation.from_rotvec(d[:, 3:]) * Rotation.from_matrix(shot.R_world_from_cam)
        * Rotation.from_matrix(placed.R_world_from_cam).inv()
    )  # fmt: skip
    errors_ = np.column_stack([there - placed.origin, angles.as_rotvec()])
    found = np.cov(errors_.T)
    sigma = np.sqrt(np.diag(placed.covariance))
    # 40 000 draws: 0.5 % of a correlation; second order 0.5 %
    assert found / np.outer(sigma, sigma) == pytest.approx(
        placed.covariance / np.outer(sigma, sigma), abs=0.03
    )
