"""Calls of the service `measure` that place clicks: points, lengths, sights, guides."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from georef_gis.errors import GeometryError, GeorefError
from georef_gis.toolbox.services import Request, call
from processing_algorithms.measure.service.base import (
    LONGEST_ID,
    MOST_CLICKS,
    MOST_VERTICES,
    ClickRequest,
    PhotoRequest,
    PlaceRequest,
    SessionService,
    VertexRequest,
    marks_of,
    told_points,
    told_sight,
)
from processing_algorithms.state import file_state

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.measure.lengths import Leg, Lengths, Quantity
    from georef_gis.measure.measured import MeasuredPoints

# photos that are told of a place
_MOST_SIGHTS = 40
_LENGTHS = ("slope", "ground", "grid", "height_difference")
_BEARINGS = ("bearing_true", "bearing_grid")


class FigureRequest(Request):
    """A point, a line or an area by the clicks of its vertices."""

    shape: Literal["point", "line", "polygon"]
    vertices: tuple[VertexRequest, ...] = Field(min_length=1, max_length=MOST_VERTICES)


class AtRequest(PlaceRequest):
    """A position on the map, and the photo to find it in."""

    photo: str | None = Field(default=None, max_length=LONGEST_ID)


class GuideRequest(PhotoRequest):
    """A photo, and the clicks in others that show one place."""

    clicks: tuple[ClickRequest, ...] = Field(min_length=1, max_length=MOST_CLICKS)


class FigureCalls(SessionService):
    """Points, lengths and areas; where places are seen."""

    @call(FigureRequest)
    def figure(self, request: FigureRequest) -> dict[str, Any]:
        """Measure what was clicked; vertices that have no place are told in `refused`."""
        points = self.session().measure(marks_of(request.vertices), on_fail="skip")
        out: dict[str, Any] = {
            "points": {
                name: told for name, told in zip(points.names, told_points(points), strict=True)
            },
            "refused": points.refused,
            "lengths": None,
        }
        fewest = {"point": 0, "line": 2, "polygon": 3}[request.shape]
        if fewest and len(points) == len(request.vertices) >= fewest:
            try:
                lengths = self.session().lines(points, closed=request.shape == "polygon")
                out["lengths"] = _told_lengths(lengths)
            except GeometryError as error:
                out["lengths_why_not"] = str(error)
        return out

    @call(ClickRequest)
    def place(self, request: ClickRequest) -> dict[str, Any]:
        """Place on the ground that a pixel shows; `why_not` where it shows none."""
        try:
            points = self._located(request)
        except GeometryError as error:
            return {"why_not": str(error)}
        (told,) = told_points(points)
        names = ("easting", "northing", "lat_deg", "lon_deg", "height_ellipsoidal_m", "sigma_e_m",
                 "sigma_n_m", "sigma_u_m", "semi_major_m")  # fmt: skip
        return {"x": told["easting"], "y": told["northing"], "ellipse": told["ellipse"],
                **{name: told[name] for name in names}}  # fmt: skip

    def _located(self, click: ClickRequest) -> MeasuredPoints:
        return self.session().locate(marks_of([VertexRequest(clicks=(click,))]))

    @call(AtRequest)
    def at(self, request: AtRequest) -> dict[str, Any]:
        """What is known of a position on the map: height, trust, and where a photo shows it."""
        import numpy as np

        from georef_gis.measure.who_sees import place_on_map

        scene = self.session().scene
        try:
            p_enu, _ = place_on_map(scene, [request.x, request.y], height=request.height)
        except GeometryError as error:
            return {"why_not": str(error)}
        lat, lon, height = scene.frame.origin.geo_from_enu(p_enu)
        every = np.arange(len(scene.photos))
        uv = scene.photos.project(every, np.broadcast_to(p_enu, (len(every), 3)))
        seeing = np.flatnonzero(scene.photos.contains(every, uv))
        out: dict[str, Any] = {
            "lat_deg": math.degrees(lat), "lon_deg": math.degrees(lon),
            "height_ellipsoidal_m": float(height), "seen": None,
        }  # fmt: skip
        number = scene.photos.number.get(request.photo or "")
        if number is not None and number in seeing:
            out["seen"] = {"u": float(uv[number, 0]), "v": float(uv[number, 1])}
        if len(seeing):
            away = scene.photos.origin_enu[seeing, :2] - p_enu[:2]
            nearest = int(seeing[np.argmin(np.hypot(away[:, 0], away[:, 1]))])
            out |= self._sigmas(scene.photos.photos[nearest].id, uv[nearest])
        return out

    def _sigmas(self, photo_id: str, uv: Array) -> dict[str, float]:
        """Sigmas of a place that a photo shows at a pixel: those of the ground and of its pose."""
        click = ClickRequest(photo=photo_id, u=float(uv[0]), v=float(uv[1]))
        try:
            (told,) = told_points(self._located(click))
        except GeometryError:
            return {}
        return {name: told[name] for name in ("sigma_e_m", "sigma_n_m", "sigma_u_m")}

    @call(PlaceRequest)
    def pick(self, request: PlaceRequest) -> dict[str, Any]:
        """Photo and pixel that stand for a click on the mosaic: those it was made of there."""
        sights = self.session().who_sees(request.x, request.y, request.height)
        if not sights:
            raise GeometryError(
                f"no photo shows the place {request.x:.2f}, {request.y:.2f}; click on the mosaic"
            )
        shown = self._mosaic_photo(request.x, request.y)
        chosen = next((one for one in sights if one.photo_id == shown), sights[0])
        return told_sight(chosen)

    def _mosaic_photo(self, x: float, y: float) -> str | None:
        """Photo that the mosaic shows at a place, by its seams; None where that is not known."""
        import shapely

        from georef_gis.project.seam_layer import SEAMS_FILE, read_seams

        path = self.project.folder / SEAMS_FILE
        mark = file_state(path)
        if not mark:
            return None
        if self._seams[0] != mark:
            frame = self.session().frame
            try:
                cells = read_seams(
                    path, photos=list(self.session().site.photos), crs_wkt=frame.crs.to_wkt()
                ).cells
            except GeorefError:
                # One who edits the seams has the file open; the best photo will do.
                return None
            self._seams = mark, shapely.STRtree([area for _, area in cells]), [k for k, _ in cells]
        _, tree, photos = self._seams
        hits = tree.query(shapely.Point(x, y), predicate="intersects")
        return photos[int(hits[0])] if len(hits) else None

    _seams: tuple[str, Any, list[str]] = ("", None, [])

    @call(AtRequest)
    def sights(self, request: AtRequest) -> dict[str, Any]:
        """Photos that show a position of the map, best first."""
        found = self.session().who_sees(request.x, request.y, request.height, best=_MOST_SIGHTS)
        return {"sights": [told_sight(one) for one in found]}

    @call(VertexRequest)
    def sights_of(self, request: VertexRequest) -> dict[str, Any]:
        """Photos that show what was clicked, best first."""
        from georef_gis.measure.who_sees import who_sees_point

        points = self.session().measure(marks_of([request]))
        found = who_sees_point(points, 0, best=_MOST_SIGHTS)
        return {"sights": [told_sight(one) for one in found]}

    @call(GuideRequest)
    def guides(self, request: GuideRequest) -> dict[str, Any]:
        """Lines in a photo on which what was clicked in others lies."""
        import numpy as np

        out = []
        for mark in marks_of([VertexRequest(clicks=request.clicks)]):
            if mark.photo == request.photo:
                continue
            for guide in self.session().guide(mark, [request.photo]):
                good = np.isfinite(guide.uv).all(axis=1)
                out.append(
                    {
                        "of": mark.photo,
                        "line": guide.uv[good].tolist(),
                        "sigma_px": guide.sigma_across[good].tolist(),
                    }
                )
        return {"guides": out}


def _told_lengths(lengths: Lengths) -> dict[str, Any]:
    return {
        "slope": _told(lengths.slope),
        "ground": _told(lengths.ground),
        "grid": _told(lengths.grid),
        "area_ground": lengths.area_ground and _told(lengths.area_ground),
        "area_grid": lengths.area_grid and _told(lengths.area_grid),
        "scale": lengths.scale,
        "legs": [_told_leg(leg) for leg in lengths.legs],
        "told": lengths.told(),
    }


def _told_leg(leg: Leg) -> dict[str, Any]:
    out = {name: _told(getattr(leg, name)) for name in _LENGTHS}
    return out | {name: _told(getattr(leg, name), math.degrees(1.0)) for name in _BEARINGS}


def _told(quantity: Quantity, factor: float = 1.0) -> dict[str, float]:
    return {
        "value": quantity.value * factor,
        "sigma": quantity.sigma * factor,
        "apart": quantity.sigma_apart * factor,
    }
