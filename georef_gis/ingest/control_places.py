"""Control points where the photos are: wrong CRS, swapped axes, feet, kinds of height, photo names.

A mistake that the photos' own positions reveal beyond doubt is named with its cure. Points whose
place is wrong are set off; heights that cannot be right are not used, the place is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import GeorefError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import (
    CRS,
    WGS84_A,
    HeightKind,
    MapFrame,
    differ_only_in_foot,
    geoid_undulation,
    horizontal_crs,
    metres_per_unit,
    parse_crs,
)
from georef_gis.ingest.control_heights import Heights, settle_heights
from georef_gis.ingest.control_photos import marks_in_photos, some_names
from georef_gis.model.control import Control, ControlObservations, ControlPoint, Mark
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

# m; control this far beyond the photos is not of this site
_FAR = 3000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """Control in the project: observations, what was wrong, and the points as settled.

    `geo` (n, 3) is (lat, lon rad, ellipsoidal height m) of `points`, NaN height for none.
    """

    points: tuple[ControlPoint, ...]
    geo: Array
    observations: ControlObservations
    doubts: tuple[str, ...]
    datum_known: bool
    height_kind: HeightKind


def place_control(
    control: Control,
    frame: MapFrame,
    terrain: Terrain,
    photos: Mapping[str, OrientedPhoto],
) -> Placed:
    """Control in the project's enu with its marks by photo id.

    Raises
    ------
    InputError
        If the datums of positions and control are unequal and cannot be transformed, or no CRS
        fits; with the cure.
    """
    cameras = np.array([photo.pose.origin_enu for photo in photos.values()])
    known = control.datum.is_known
    own = MapFrame(
        frame.origin,
        control.crs,
        gnss_datum=frame.gnss_datum,
        crs_datum=control.datum if known else None,
    )
    xy = np.array([[q.easting, q.northing] for q in control.points])
    geo, far, place_doubts = _located(control, own, frame, xy, cameras)
    points = [replace(q, role="off") if f else q for q, f in zip(control.points, far, strict=True)]
    heights = _heights(control, points, geo, far, own, terrain, photos)
    geo[:, 2] = heights.ellipsoidal
    sigma_datum = own.datum_sigma
    doubts = [*place_doubts, *heights.doubts]
    if differ_only_in_foot(control.crs, frame.crs):
        off = 2e-6 * metres_per_unit(own.horizontal) * float(np.median(np.abs(xy).max(axis=1)))
        doubts.append(
            f"{_file(control)}: crs: '{control.crs.name}' and the project's '{frame.crs.name}' "
            f"differ only in the foot, US survey or international, {off:.2f} m here; is one meant?"
        )
    if sigma_datum and not far.all():
        open_ends = [
            f"[{section}] datum"
            for section, datum in (("control", own.crs_datum), ("gnss", own.gnss_datum))
            if not datum.is_known
        ]
        doubts.append(
            f"{_file(control)}: datum: {' and '.join(open_ends)} not stated; all points may be "
            f"shifted against the positions by {sigma_datum:g} m (one sigma east and north)"
        )
    marks, others = marks_in_photos(control.marks, photos)
    observations = _observations(points, geo, far, marks, frame, terrain, sigma_datum)
    return Placed(
        points=tuple(points), geo=geo, observations=observations, doubts=(*doubts, *others),
        datum_known=not sigma_datum, height_kind=heights.kind,
    )  # fmt: skip


def _observations(
    points: Sequence[ControlPoint], geo: Array, far: NDArray[np.bool_],
    marks: Sequence[tuple[str, Mark]], frame: MapFrame, terrain: Terrain, sigma_datum: float,
) -> ControlObservations:  # fmt: skip
    usable = [i for i in range(len(points)) if not far[i]]
    number = {points[i].name: k for k, i in enumerate(usable)}
    p = _on_ground(geo[usable], frame, terrain)
    sigma = np.array(
        [
            [points[i].sigma_h] * 2 + [points[i].sigma_v if np.isfinite(geo[i, 2]) else np.inf]
            for i in usable
        ]
    ).reshape(-1, 3)
    used = [(key, mark) for key, mark in marks if mark.name in number]
    rays = Counter(mark.name for _, mark in used)
    return ControlObservations(
        names=tuple(points[i].name for i in usable),
        role=tuple(points[i].role for i in usable),
        p_enu=p,
        sigma=sigma,
        photo_ids=tuple(key for key, _ in used),
        point=np.array([number[mark.name] for _, mark in used], dtype=np.int32),
        uv=np.array([[mark.u, mark.v] for _, mark in used]).reshape(-1, 2),
        # an adjustment takes marks as independent
        sigma_px=np.array([mark.kept_px(rays[mark.name]) for _, mark in used]),
        source=tuple(mark.source for _, mark in used),
        sigma_shared=np.array([sigma_datum, sigma_datum, 0.0]),
    )


def _on_ground(geo: Array, frame: MapFrame, terrain: Terrain) -> Array:
    """Enu of points; where there is no height, that of the ground below; shape (n, 3), m."""
    flat = np.where(np.isfinite(geo), geo, frame.origin.height_ellipsoidal)
    p = np.asarray(frame.origin.enu_from_geo(flat)).reshape(-1, 3)
    # The height of the ground moves the horizontal place by less than a micrometre per metre.
    z = terrain.z_at(p[:, :2])
    bare = ~np.isfinite(geo[:, 2])
    p[bare, 2] = np.where(np.isfinite(z[bare]), z[bare], 0.0)
    return p


# -- places ------------------------------------------------------------------------------------


def _located(
    control: Control, own: MapFrame, frame: MapFrame, xy: Array, cameras: Array
) -> tuple[Array, NDArray[np.bool_], list[str]]:
    """Geographic places, which points lie far from the photos, and why."""
    reach = _FAR + float(np.linalg.norm(np.ptp(cameras[:, :2], axis=0)))
    reach += 10.0 * float(np.max(np.abs(cameras[:, 2])))
    middle = np.median(cameras, axis=0)

    def away(geo: Array) -> Array:
        flat = np.where(np.isfinite(geo), geo, 0.0)
        d = np.linalg.norm(frame.origin.enu_from_geo(flat)[..., :2] - middle[:2], axis=-1)
        out = np.asarray(np.where(np.all(np.isfinite(geo), axis=-1), d, np.inf))
        # Beyond a quarter of the Earth enu's east and north grow smaller again.
        east = (geo[..., 1] - frame.origin.lon + np.pi) % (2.0 * np.pi) - np.pi
        angle = np.hypot(geo[..., 0] - frame.origin.lat, east * np.cos(frame.origin.lat))
        return np.where(angle > 0.5, angle * WGS84_A, out)

    geo = _geo_from(own, control.crs, xy)
    distance = away(geo)
    far = distance > reach
    if not far.any():
        return geo, far, []
    if control.order_open and far.all():
        swapped = _geo_from(own, control.crs, xy[:, ::-1])
        if np.all(away(swapped) <= reach):
            # A table without a header follows the CRS: PIX4Dmatic writes latitude first.
            return swapped, np.zeros(len(xy), bool), []
    doubts = []
    left = far.copy()
    for words, read in _misreadings(control, frame, own):
        found = left & (away(read(xy)) <= reach) if left.any() else left
        if found.any():
            doubts.append(_far_line(control, xy, distance, found, words))
            left &= ~found
    if left.any():
        cure = f"check the numbers and the CRS ('{control.crs.name}')"
        doubts.append(_far_line(control, xy, distance, left, cure))
    return geo, far, doubts


def _geo_from(frame: MapFrame, crs: CRS, xy: Array) -> Array:
    """(lat, lon, 0) of coordinates in a projected or a geographic CRS; shape (n, 3)."""
    flat = np.column_stack([xy, np.zeros(len(xy))])
    geo = np.asarray(frame.geo_from_map(flat))
    # What lies outside of the projection gives numbers of no meaning, or none.
    bad = ~np.all(np.isfinite(geo), axis=1)
    if not crs.is_projected:
        bad |= (np.abs(xy[:, 0]) > 360.0) | (np.abs(xy[:, 1]) > 90.0)
    geo[bad] = np.nan
    return geo


_Read = Callable[[Array], Array]


def _misreadings(control: Control, frame: MapFrame, own: MapFrame) -> Iterator[tuple[str, _Read]]:
    """What users get wrong, best known first: words with the cure, and the right reading."""
    crs = horizontal_crs(control.crs)
    yield "exchanged they lie at the photos: exchange the two columns", _reading(own, swap=True)
    if crs.is_projected:
        unit = metres_per_unit(crs)
        for name, length in (
            ("metres", 1.0), ("US survey feet", US_SURVEY_FOOT), ("feet", INTERNATIONAL_FOOT),
        ):  # fmt: skip
            if abs(length - unit) > 1e-9:
                words = (
                    f"in {name} they lie at the photos, but the CRS is in units of {unit:.7g} m: "
                    "name the CRS in that unit or convert them"
                )
                yield words, _reading(own, scale=(length / unit, length / unit))
    else:
        yield (
            "with the sign of the longitude turned they lie at the photos: west is negative",
            _reading(own, scale=(-1.0, 1.0)),
        )
        yield (
            "with the sign of the latitude turned they lie at the photos: south is negative",
            _reading(own, scale=(1.0, -1.0)),
        )
    for text, other in _other_crs(crs, frame):
        yield f"in {text} they lie at the photos: correct the CRS", _reading(other)
        yield (
            f"in {text} and exchanged they lie at the photos: correct the CRS and the columns",
            _reading(other, swap=True),
        )


def _reading(
    frame: MapFrame, *, swap: bool = False, scale: tuple[float, float] = (1.0, 1.0)
) -> _Read:
    """Function from numbers as written, (n, 2), to geographic places."""

    def read(xy: Array) -> Array:
        return _geo_from(frame, frame.crs, (xy[:, ::-1] if swap else xy) * scale)

    return read


def _other_crs(crs: CRS, frame: MapFrame) -> Iterator[tuple[str, MapFrame]]:
    """CRSs that the numbers may be of: degrees, the project's, neighbouring UTM zones."""
    texts = ["EPSG:4326"]
    code = crs.to_epsg()
    if code and (32601 <= code <= 32660 or 32701 <= code <= 32760):
        zone, north = code % 100, code < 32700
        texts += [f"EPSG:{(32700 if north else 32600) + zone}"]
        texts += [f"EPSG:{code + step}" for step in (-1, 1) if 1 <= zone + step <= 60]
    for text in texts:
        yield text, MapFrame(frame.origin, parse_crs(text))
    plain = frame.horizontal
    yield f"the project's CRS ({plain.name})", MapFrame(frame.origin, plain)


def _far_line(
    control: Control, xy: Array, distance: Array, found: NDArray[np.bool_], words: str
) -> str:
    which = np.flatnonzero(found)
    first = control.points[which[0]]
    unit = control.crs.axis_info[0].unit_name
    d = distance[which[0]]
    where = f"{d / 1000:.0f} km from the photos" if np.isfinite(d) else "outside of the CRS"
    count = f"{len(which)} points ({some_names([control.points[i].name for i in which])})"
    return (
        f"{first.source}: easting, northing: {count} such as {xy[which[0], 0]:.10g} "
        f"{xy[which[0], 1]:.10g} {unit} lie {where}; {words}; not used"
    )


# -- heights -----------------------------------------------------------------------------------


def _heights(
    control: Control, points: Sequence[ControlPoint], geo: Array, far: NDArray[np.bool_],
    frame: MapFrame, terrain: Terrain, photos: Mapping[str, OrientedPhoto],
) -> Heights:  # fmt: skip
    """Ellipsoidal heights of the points where kind and unit are known or can be told."""
    z = np.array([np.nan if q.height is None else q.height for q in points])
    z[far] = np.nan
    ok = np.isfinite(z)
    if ok.any() and control.height_kind is HeightKind.ELLIPSOIDAL:
        # Above the ellipsoid of the control's datum, 1 to 2 m from that of ITRF.
        xy = np.array([[q.easting, q.northing] for q in points])[ok]
        z[ok] = frame.geo_from_map(np.column_stack([xy, z[ok]]))[:, 2]
    undulation = np.full(len(z), np.nan)
    if ok.any() and control.height_kind is not HeightKind.ELLIPSOIDAL:
        try:
            undulation[ok] = geoid_undulation(
                geo[ok, 0], geo[ok, 1], geoid=control.geoid, datum=frame.gnss_datum
            )
        except GeorefError as error:
            return Heights.none(z, f"{_file(control)}: {error}; used without height")
    ground = np.full(len(z), np.nan)
    if ok.any():
        ground[ok] = _ground_heights(geo[ok], frame, terrain)
    shared = float(np.median([photo.pose.sigma_height_shared for photo in photos.values()]))
    settled = settle_heights(
        z, undulation, ground, sigma_ground=float(np.hypot(terrain.sigma, shared)),
        kind=control.height_kind, unit=control.height_unit, source=_file(control),
    )  # fmt: skip
    crs = control.crs
    in_feet = crs.is_projected and metres_per_unit(horizontal_crs(crs)) < 0.5
    if control.height_unit is None and in_feet and not settled.doubts and ok.any():
        words = "unit not stated, the CRS is in feet; taken as metres: state [control] height_unit"
        return replace(settled, doubts=(f"{_file(control)}: height: {words}",))
    return settled


def _ground_heights(geo: Array, frame: MapFrame, terrain: Terrain) -> Array:
    """Ellipsoidal height of the ground below places, m; NaN outside of it."""
    flat = np.column_stack([geo[:, :2], np.full(len(geo), frame.origin.height_ellipsoidal)])
    p = np.asarray(frame.origin.enu_from_geo(flat)).reshape(-1, 3)
    p[:, 2] = terrain.z_at(p[:, :2])
    out = np.full(len(geo), np.nan)
    ok = np.isfinite(p[:, 2])
    out[ok] = np.asarray(frame.origin.geo_from_enu(p[ok]))[..., 2]
    return out


def _file(control: Control) -> str:
    return control.points[0].source.rpartition(", ")[0] or control.points[0].source


def with_roles(
    control: Control, *, control_names: Sequence[str], check: Sequence[str], off: Sequence[str]
) -> Control:
    """Control with roles that the user gives by name; a name in two lists or none is told."""
    roles = {
        **dict.fromkeys(control_names, "control"),
        **dict.fromkeys(check, "check"),
        **dict.fromkeys(off, "off"),
    }
    listed = [*control_names, *check, *off]
    twice = sorted({name for name in listed if listed.count(name) > 1})
    if twice:
        raise InputError(
            f"point {some_names(twice)} stands in two of control, check and off; keep one",
            source="project.toml",
            field="control",
        )
    known = {point.name for point in control.points}
    strange = [name for name in roles if name not in known]
    points = tuple(
        replace(q, role=roles[q.name]) if q.name in roles else q  # type: ignore[arg-type]
        for q in control.points
    )
    told = [
        f"project.toml: control: no point is called {some_names(strange)}; the names are "
        f"{some_names(sorted(known))}"
    ]
    return replace(control, points=points).saying(*(told if strange else ()))
