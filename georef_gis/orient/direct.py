"""Direct orientation: the pose of every photo from its tags alone, with a covariance to match."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from georef_gis.errors import GeorefError, MissingMetadataError
from georef_gis.frames import Array, R_enu_from_ned, exp_so3, skew
from georef_gis.geodesy import Origin
from georef_gis.model.photo import AttitudeTag, Geotag, Photo
from georef_gis.model.pose import Mount, Pose
from georef_gis.orient.dialects import R_enu_from_cam_of_tag, dialect
from georef_gis.orient.heights import Heights

# m, one sigma per axis, of a consumer receiver: white 0.7 m and slow 2 m, as the 2012 paper's
# and the report's 2.5 m CEP (2.1 m per axis)
SIGMA_GNSS = 2.2
# rad, one sigma of a course taken for a heading: wind puts a small fixed wing at 10-15 deg of crab
SIGMA_CRAB = math.radians(15.0)
# rad, one sigma of roll and pitch when nothing is known: level flight in turbulence
SIGMA_LEVEL = math.radians(6.0)
# rad, one sigma of a uniform heading
SIGMA_ANY_HEADING = math.pi / math.sqrt(3.0)
# m; neighbours closer than this give no course
SHORTEST_LEG = 4.0
# a leg made good at less than this share of its neighbour's speed has a turn in it
TURN_SPEED_SHARE = 0.4
# rad; a photo tilted more than this shows no map
TILT_LIMIT = math.radians(60.0)
# m; lower than this a photo stands on the ground
LOWEST_HEIGHT = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectSettings:
    """What the user adds to the tags; angles in rad, sigmas one standard deviation."""

    sigma_h: float | None = None
    sigma_roll_pitch: float | None = None
    sigma_yaw: float | None = None
    # m, one sigma; of the datum, the same for all photos of a flight
    sigma_datum: float = 0.0
    # "auto", "tags" or "course"
    yaw_source: str = "auto"
    # photo name -> degrees clockwise by which an editor turned its pixels (90, 180, 270)
    rotate_photos: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DirectPose:
    """Pose of one photo, or why there is none; doubts in words for people."""

    photo_id: str
    pose: Pose | None
    height_above_ground: float = math.nan
    # degrees clockwise by which the pixels were turned after exposure
    turned_deg: int = 0
    doubts: tuple[str, ...] = ()
    refused: GeorefError | None = None


def courses_over_ground(photos: Sequence[Photo], origin: Origin) -> dict[str, float]:
    """Course made good, rad clockwise from north, from the positions of neighbours in time.

    The mean of the legs before and after a photo, unless a turn lies in one of them: where the
    clocks tell, the one made good at less than `TURN_SPEED_SHARE` of the other's speed, else the
    longer of two that differ by more than 45 deg. No entry where there is no leg.
    """
    tracked = [p for p in photos if p.geotag is not None]
    if len(tracked) < 2:
        return {}
    geo = [[p.geotag.lat, p.geotag.lon, origin.height_ellipsoidal] for p in tracked if p.geotag]
    xy = origin.enu_from_geo(np.array(geo))[:, :2]
    out: dict[str, float] = {}
    for i, photo in enumerate(tracked):
        legs = []
        for j, k in ((i - 1, i), (i, i + 1)):
            if j < 0 or k >= len(tracked) or tracked[j].flight_id != tracked[k].flight_id:
                continue
            d = xy[k] - xy[j]
            if np.hypot(*d) >= SHORTEST_LEG:
                legs.append((d, _seconds_between(tracked[j], tracked[k])))
        if not legs:
            continue
        e, n = np.sum([d / np.hypot(*d) for d in _without_turn(legs)], axis=0)
        out[photo.id] = math.atan2(e, n)
    return out


def _seconds_between(first: Photo, second: Photo) -> float | None:
    """Time from one photo to the next, not less than its resolution, s; None where not known."""
    if first.time_gps is not None and second.time_gps is not None:
        return max(second.time_gps - first.time_gps, 1e-3)
    if first.camera_clock is None or second.camera_clock is None:
        return None
    seconds = (second.camera_clock - first.camera_clock).total_seconds()
    return max(seconds, first.clock_resolution_s)


def _without_turn(legs: list[tuple[Array, float | None]]) -> list[Array]:
    """Those of one or two legs (m, and the time they took) that were flown straight."""
    if len(legs) < 2:
        return [d for d, _ in legs]
    (first, t_first), (second, t_second) = legs
    a, b = float(np.hypot(*first)), float(np.hypot(*second))
    if t_first is not None and t_second is not None:
        v_first, v_second = a / t_first, b / t_second
        if min(v_first, v_second) < TURN_SPEED_SHARE * max(v_first, v_second):
            return [first if v_first > v_second else second]
    if first @ second < math.cos(math.pi / 4) * a * b:
        return [first if a <= b else second]
    return [first, second]


def direct_poses(
    photos: Sequence[Photo],
    origin: Origin,
    heights: Heights,
    mount: Mount,
    settings: DirectSettings,
    *,
    convergence_at: Callable[[Array], float],
) -> list[DirectPose]:
    """Pose of every photo from its tags; one that has none is refused, the others go on.

    Parameters
    ----------
    photos
        In order of time within each flight.
    convergence_at
        Meridian convergence, rad, at a place of enu (3,); for pose files with omega, phi, kappa.
    """
    courses = courses_over_ground(photos, origin)
    out = []
    for photo in photos:
        try:
            one = _direct_pose(
                photo, origin, heights, mount, settings, courses.get(photo.id), convergence_at
            )
        except GeorefError as error:
            one = DirectPose(photo_id=photo.id, pose=None, refused=error)
        out.append(one)
    return out


def _direct_pose(
    photo: Photo,
    origin: Origin,
    heights: Heights,
    mount: Mount,
    settings: DirectSettings,
    course: float | None,
    convergence_at: Callable[[Array], float],
) -> DirectPose:
    tag, height = _place(photo, heights)
    p_tag = origin.enu_from_geo([tag.lat, tag.lon, height])
    convergence = convergence_at(p_tag)
    attitude, sigma_rp, sigma_yaw, doubts = _attitude(photo, settings, course, convergence)
    if photo.id in heights.photo_doubts:
        doubts.append(heights.photo_doubts[photo.id])
    R_enu_cam = R_enu_from_cam_of_tag(
        attitude,
        yaw=attitude.yaw or 0.0,
        origin=origin,
        vehicle_lat=tag.lat,
        vehicle_lon=tag.lon,
        mount=mount,
        convergence=convergence,
    )
    R_enu_ned = R_enu_from_ned(origin.lat, origin.lon, tag.lat, tag.lon)
    lever = np.zeros(3)
    if tag.of != "camera":
        # A tag of unknown meaning is taken for the antenna's: receivers tag what they measure.
        lever = R_enu_cam @ mount.R_body_from_cam.T @ mount.antenna_to_camera_body
    covariance = _covariance(photo, heights, mount, settings, sigma_rp, sigma_yaw, R_enu_ned, lever)
    turned = settings.rotate_photos.get(photo.id, settings.rotate_photos.get(photo.path.name, 0))
    pose = Pose(
        origin_enu=p_tag + lever,
        R_enu_from_cam=_orthonormal(R_enu_cam @ exp_so3([0.0, 0.0, -math.radians(turned)])),
        covariance=covariance,
        kind="tags",
        sigma_height_shared=heights.sigma_shared,
        height_kind=heights.kinds.get(photo.id, ""),
    )
    agl = float(pose.origin_enu[2] - heights.terrain.z_at(pose.origin_enu[:2]))
    _refuse_useless(photo, pose, agl)
    return DirectPose(
        photo_id=photo.id,
        pose=pose,
        height_above_ground=agl,
        turned_deg=int(turned),
        doubts=tuple(doubts),
    )


def _place(photo: Photo, heights: Heights) -> tuple[Geotag, float]:
    """Position of a photo by its tag, and its height, m over the ellipsoid."""
    if photo.geotag is None:
        raise MissingMetadataError(
            "no GPS position; give one in a pose file ([poses] file)", source=photo.id, field="GPS"
        )
    if photo.id not in heights.cameras:
        raise MissingMetadataError(
            "no height; give one in a pose file or set [ground] height_above_ground_m",
            source=photo.id,
            field="GPSAltitude",
        )
    return photo.geotag, heights.cameras[photo.id]


def _orthonormal(R: Array) -> Array:
    """Nearest rotation: rounding of products of many matrices stays below 1e-15 anyway."""
    u, _, vt = np.linalg.svd(R)
    return np.asarray(u @ vt)


def _attitude(
    photo: Photo, settings: DirectSettings, course: float | None, convergence: float
) -> tuple[AttitudeTag, float, float, list[str]]:
    """Attitude to use, its sigmas (rad) and what is doubtful about it."""
    doubts: list[str] = []
    tag = photo.attitude
    course = photo.course if photo.course is not None else course
    if tag is None:
        tag = AttitudeTag(dialect="ypr", roll=0.0, pitch=0.0, yaw=None)
        sigma_rp, sigma_yaw = SIGMA_LEVEL, SIGMA_CRAB
        doubts.append("no attitude in the tags: taken as level")
    else:
        entry = dialect(tag.dialect)
        sigma_rp = tag.sigma_roll_pitch or entry.sigma_roll_pitch
        sigma_yaw = tag.sigma_yaw or entry.sigma_yaw
    if settings.yaw_source == "course" or tag.yaw is None:
        sigma_yaw = SIGMA_CRAB
        if course is None:
            doubts.append("no heading and no neighbour to take a course from: laid north-up")
            course, sigma_yaw = 0.0, SIGMA_ANY_HEADING
        elif tag.yaw is None:
            doubts.append(f"no heading in the tags: course made good {_deg(course)} deg is used")
        tag = with_heading(tag, course, convergence)
    elif tag.yaw_is_course:
        sigma_yaw = max(sigma_yaw, SIGMA_CRAB)
    sigma_rp = settings.sigma_roll_pitch or sigma_rp
    sigma_yaw = settings.sigma_yaw or sigma_yaw
    return tag, sigma_rp, sigma_yaw, doubts


def _deg(angle: float) -> str:
    return f"{math.degrees(angle) % 360.0:.0f}"


def with_heading(tag: AttitudeTag, heading: float, convergence: float = 0.0) -> AttitudeTag:
    """Tag whose image top points to a heading, rad clockwise from true north.

    A gimbal near nadir has yaw + roll for its heading; kappa runs counter-clockwise from the
    map's axes, which the meridian convergence turns.
    """
    entry = dialect(tag.dialect)
    yaw = heading
    if entry.nominal == "photo":
        yaw = convergence - heading
    elif entry.nominal == "horizon" and tag.pitch < -math.pi / 4:
        yaw = heading - tag.roll
    return replace(tag, yaw=yaw, yaw_is_course=True)


def _covariance(
    photo: Photo,
    heights: Heights,
    mount: Mount,
    settings: DirectSettings,
    sigma_rp: float,
    sigma_yaw: float,
    R_enu_ned: Array,
    lever_enu: Array,
) -> Array:
    """Covariance of (dp, dtheta) in enu; shape (6, 6), m and rad.

    The tilt's sigma holds about both level axes, so that it stays right at -90 deg of pitch, where
    roll and yaw of a gimbal are one angle. The height is that above the ground.
    """
    tag = photo.geotag
    sigma_h = settings.sigma_h or (tag.sigma_h if tag else None) or SIGMA_GNSS
    theta_ned = np.diag(np.array([sigma_rp, sigma_rp, sigma_yaw]) ** 2)
    theta = R_enu_ned @ theta_ned @ R_enu_ned.T + np.eye(3) * mount.sigma_boresight**2
    position = np.diag(
        np.array([sigma_h, sigma_h, heights.sigma[photo.id]]) ** 2
        + np.array([settings.sigma_datum, settings.sigma_datum, 0.0]) ** 2
        + mount.sigma_lever_arm**2
    )
    # The lever arm turns with the attitude: dp = dtheta x lever.
    J = -skew(lever_enu)
    out = np.zeros((6, 6))
    out[:3, :3] = position + J @ theta @ J.T
    out[:3, 3:] = J @ theta
    out[3:, :3] = out[:3, 3:].T
    out[3:, 3:] = theta
    return out


def _refuse_useless(photo: Photo, pose: Pose, agl: float) -> None:
    """Refuse a frame taken on the ground or one that looks at the horizon."""
    if math.isfinite(agl) and agl < LOWEST_HEIGHT:
        raise MissingMetadataError(
            f"taken {agl:.1f} m above the ground: on the ground? left out; check the heights "
            "if it was flown",
            source=photo.id,
            field="height",
        )
    if pose.tilt > TILT_LIMIT:
        raise MissingMetadataError(
            f"looks {math.degrees(pose.tilt):.0f} deg away from straight down, more than "
            f"{math.degrees(TILT_LIMIT):.0f}: left out of the map",
            source=photo.id,
            field="pitch",
        )
