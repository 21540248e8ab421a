"""Draws a simulated flight from its conditions: every source of error by its sigma."""

from __future__ import annotations

import math

import numpy as np
from flight_truth import (
    R_BODY_FROM_CAM,
    R_ENU_FROM_NED,
    Array,
    Conditions,
    Ints,
    Line,
    Relief,
    Shared,
    SimCamera,
    SimFlight,
    Surveyed,
    Truth,
    pixels_in_photo,
    turn,
)
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

# s; from the end of a line to the start of the next
TURN_S = 12.0


def fly(seed: int, lines: list[Line], conditions: Conditions) -> SimFlight:
    """One flight with every source of error drawn from its sigma."""
    rng = np.random.default_rng(seed)
    c = conditions
    camera, camera_true, camera_sigma = _cameras(rng, c)
    relief = _relief(rng, c.relief)
    shared = Shared(boresight=np.zeros(3), lever=np.array(c.lever), bias=np.zeros(3), clock=0.0)
    shared_true = Shared(
        boresight=c.sigmas.boresight * rng.standard_normal(3),
        lever=shared.lever + c.sigmas.lever * rng.standard_normal(3),
        bias=c.sigmas.bias * rng.standard_normal(3),
        clock=float(c.sigmas.clock * rng.standard_normal()),
    )
    truth = _trajectory(rng, lines, c, shared_true)
    errors = c.navigation.draw(rng, truth.times)
    late = turn(shared_true.clock * truth.rate)
    p_nav = truth.p_imu + shared_true.clock * truth.velocity + shared_true.bias - errors[:, :3]
    R_nav = turn(-errors[:, 3:]) @ late @ truth.R_enu_from_body
    points, seen = _ground(rng, c, relief, lines, (camera_true, truth, shared_true))
    photo, point, uv, outlier = seen
    surveyed = [
        _survey(rng, c, n, relief, lines, (camera_true, truth, shared_true))
        for n in (c.control, c.check)
    ]
    return SimFlight(
        seed=seed,
        conditions=c,
        camera_true=camera_true,
        camera=camera,
        camera_sigma=camera_sigma,
        sigma_readout_s=c.sigma_readout_s,
        truth=truth,
        navigation=c.navigation,
        p_nav=p_nav,
        R_nav=R_nav,
        errors=errors,
        shared_true=shared_true,
        shared=shared,
        sigmas=c.sigmas,
        relief=relief,
        points=points,
        photo=photo,
        point=point,
        uv=uv,
        outlier=outlier,
        noise_px=c.noise_px,
        control=surveyed[0],
        check=surveyed[1],
    )


_Scene = tuple[SimCamera, Truth, Shared]
_Seen = tuple[Ints, Ints, Array, NDArray[np.bool_]]


def _cameras(rng: np.random.Generator, c: Conditions) -> tuple[SimCamera, SimCamera, Array]:
    middle = np.array([(c.width - 1) / 2, (c.height - 1) / 2]) + c.principal_off
    nominal = np.array([c.focal, c.focal, *middle, *c.distortion, 0.0, 0.0])
    draw = rng.standard_normal(11)
    # One focal length: the affinity b1, b2 is what tells fx from fy.
    draw[1] = draw[0]
    sigma = np.array(
        [c.sigma_focal] * 2
        + [c.sigma_principal] * 2
        + [*c.sigma_distortion]
        + [c.sigma_affinity] * 2
    )
    readout = c.readout_s + c.sigma_readout_s * float(rng.standard_normal())
    size = {"width": c.width, "height": c.height}
    return (
        SimCamera(**size, values=nominal, readout_s=c.readout_s),
        SimCamera(**size, values=nominal + sigma * draw, readout_s=readout),
        sigma,
    )


def _relief(rng: np.random.Generator, size: float) -> Relief:
    k = 6
    lengths = rng.uniform(60.0, 400.0, k)
    ways = rng.uniform(0.0, 2 * np.pi, k)
    waves = 2 * np.pi / lengths[:, None] * np.stack([np.cos(ways), np.sin(ways)], axis=1)
    # Short waves are low: slopes stay below some 15 deg.
    amplitudes = size * lengths / 400.0 * rng.uniform(0.3, 1.0, k)
    return Relief(
        slope=size / 4.0 * rng.normal(0.0, 0.03, 2),
        amplitudes=amplitudes,
        waves=waves,
        phases=rng.uniform(0.0, 2 * np.pi, k),
    )


def _trajectory(
    rng: np.random.Generator, lines: list[Line], c: Conditions, shared: Shared
) -> Truth:
    times, courses, speeds, places = [], [], [], []
    t = 100.0
    for line in lines:
        along = np.arange(line.n) * line.spacing
        way = np.array([math.sin(line.course), math.cos(line.course)])
        xy = np.array(line.start) + along[:, None] * way
        places.append(np.column_stack([xy, np.full(line.n, line.height)]))
        times.append(t + along / line.speed)
        courses.append(np.full(line.n, line.course))
        speeds.append(np.full(line.n, line.speed))
        t = times[-1][-1] + TURN_S
    course, speed = np.concatenate(courses), np.concatenate(speeds)
    n = len(course)
    crab = np.repeat(rng.normal(0.0, math.radians(4.0), len(lines)), [line.n for line in lines])
    yaw = course + crab + rng.normal(0.0, math.radians(1.5), n)
    tilt = rng.normal(0.0, math.radians(c.tilt_deg), (n, 2))
    angles = np.column_stack([yaw, tilt])
    R_body = R_ENU_FROM_NED @ Rotation.from_euler("ZYX", angles).as_matrix()
    velocity = np.column_stack([speed * np.sin(course), speed * np.cos(course), np.zeros(n)])
    velocity = velocity + rng.normal(0.0, 0.3, (n, 3))
    p_imu = np.concatenate(places) + rng.normal(0.0, [1.0, 1.0, 0.7], (n, 3))
    R_body_from_cam = turn(shared.boresight) @ R_BODY_FROM_CAM
    return Truth(
        times=np.concatenate(times),
        p_imu=p_imu,
        R_enu_from_body=R_body,
        velocity=velocity,
        rate=rng.normal(0.0, math.radians(c.rate_deg_s), (n, 3)),
        p_cam=p_imu + R_body @ shared.lever,
        R_enu_from_cam=R_body @ R_body_from_cam,
    )


def _area(lines: list[Line], c: Conditions, margin: float) -> tuple[Array, Array]:
    """Corners of the box of all lines, widened by `margin` of half the image's shorter side, m."""
    ends = []
    for line in lines:
        way = np.array([math.sin(line.course), math.cos(line.course)])
        ends += [np.array(line.start), line.start + (line.n - 1) * line.spacing * way]
    reach = margin * max(line.height for line in lines) * min(c.width, c.height) / 2 / c.focal
    return np.min(ends, axis=0) - reach, np.max(ends, axis=0) + reach


def _look(
    rng: np.random.Generator, scene: _Scene, p: Array, noise: float, found: float
) -> tuple[Ints, Ints, Array]:
    """What every photo sees of points: photo, point, uv with noise, in order of the points."""
    camera, truth, shared = scene
    photos, points, pixels = [], [], []
    for i, centre in enumerate(truth.p_cam):
        # Beyond 65 deg from the vertical nothing is seen: 45 deg to the corner, and the tilt.
        near = np.hypot(*(p[:, :2] - centre[:2]).T) < 2.2 * (centre[2] - p[:, 2])
        candidates = np.flatnonzero(near & (rng.random(len(p)) < found))
        uv = pixels_in_photo(camera, truth, shared, i, p[candidates])
        inside = camera.inside(uv)
        n = np.count_nonzero(inside)
        photos.append(np.full(n, i))
        points.append(candidates[inside])
        pixels.append(uv[inside] + noise * rng.standard_normal((n, 2)))
    photo, point, uv = (np.concatenate(x) for x in (photos, points, pixels))
    order = np.lexsort((photo, point))
    return photo[order], point[order], uv[order]


def _ground(
    rng: np.random.Generator, c: Conditions, relief: Relief, lines: list[Line], scene: _Scene
) -> tuple[Array, _Seen]:
    low, high = _area(lines, c, 1.6)
    heights = np.repeat([line.height for line in lines], [line.n for line in lines])
    footprint = float(np.mean(heights**2)) * c.width * c.height / c.focal**2
    k = int(np.ceil(np.prod(high - low) * c.obs_per_photo / (c.found * footprint)))
    xy = rng.uniform(low, high, (k, 2))
    p = np.column_stack([xy, relief.z_at(xy)])
    # Grass, stones, roofs: no surface of a formula is the ground itself.
    p[:, 2] += rng.normal(0.0, 0.1, k)
    photo, point, uv = _look(rng, scene, p, c.noise_px, c.found)
    rays = np.bincount(point, minlength=k)
    keep = rays[point] >= 2
    number = np.cumsum(rays >= 2) - 1
    photo, point, uv = photo[keep], number[point[keep]], uv[keep]
    outlier = rng.random(len(uv)) < c.outliers
    way = rng.uniform(0.0, 2 * np.pi, len(uv))
    off = rng.uniform(5.0, 200.0, len(uv)) * outlier
    uv = uv + off[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1)
    return p[rays >= 2], (photo, point, uv, outlier)


def _survey(
    rng: np.random.Generator,
    c: Conditions,
    n: int,
    relief: Relief,
    lines: list[Line],
    scene: _Scene,
) -> Surveyed:
    low, high = _area(lines, c, 0.5)
    # Stratified: corners and middle first, so that few points still span the site.
    share = np.array([[0.08, 0.08], [0.92, 0.92], [0.5, 0.5], [0.08, 0.92], [0.92, 0.08]])
    spread = np.concatenate([share, rng.uniform(0.03, 0.97, (max(n - 5, 0), 2))])[:n]
    xy = low + (high - low) * np.clip(spread + rng.normal(0.0, 0.02, (n, 2)), 0.0, 1.0)
    p = np.column_stack([xy, relief.z_at(xy)])
    sigma = np.array([c.sigma_survey[0], c.sigma_survey[0], c.sigma_survey[1]])
    surveyed = p + sigma * rng.standard_normal((n, 3))
    photo, point, uv = _look(rng, scene, p, c.mark_px, 1.0)
    return Surveyed(
        p_true=p,
        p=surveyed,
        sigma=sigma,
        photo=photo,
        point=point,
        uv=uv,
        sigma_px=c.mark_px,
    )
