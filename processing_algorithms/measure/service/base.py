"""What the calls of the service `measure` share: the session, opened anew after every run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import Field

from georef_gis.toolbox.services import Renewed, Request, Service
from processing_algorithms.measure.marks import CLICK
from processing_algorithms.state import runs_done

if TYPE_CHECKING:
    from collections.abc import Sequence

    from georef_gis.measure.ellipses import Ellipse
    from georef_gis.measure.measured import MeasuredPoints
    from georef_gis.measure.who_sees import Sighting
    from georef_gis.model.control import Mark
    from georef_gis.project import Project
    from processing_algorithms.measure.session import MeasureSession

LONGEST_ID, LONGEST_TEXT = 500, 10_000
MOST_CLICKS, MOST_VERTICES = 200, 2000
# Probability of the ellipses that a page draws.
CONF = 0.95


class NothingRequest(Request):
    """Nothing to ask for."""


class PhotoRequest(Request):
    """A photo by its id."""

    photo: str = Field(max_length=LONGEST_ID)


class ClickRequest(PhotoRequest):
    """A pixel of a photo; (0, 0) = centre of the first one.

    `shared_px` is what clicks that were matched from one another err by alike, `on_ground` says
    that the spot lies on the ground; see `Mark`.
    """

    u: float = Field(ge=-1e6, le=1e6)
    v: float = Field(ge=-1e6, le=1e6)
    sigma_px: float | None = Field(default=None, gt=0, le=1000)
    shared_px: float = Field(default=0.0, ge=0, le=1000)
    on_ground: bool = False


class VertexRequest(Request):
    """What shows one place: a click, or several in different photos."""

    clicks: tuple[ClickRequest, ...] = Field(min_length=1, max_length=MOST_CLICKS)


class PlaceRequest(Request):
    """A position on the map, in units of the project CRS; height in m above the ellipsoid."""

    x: float = Field(ge=-1e9, le=1e9)
    y: float = Field(ge=-1e9, le=1e9)
    height: float | None = Field(default=None, ge=-1e5, le=1e5)


class SessionService(Service):
    """Base of the parts of the service."""

    def __init__(self, project: Project) -> None:
        super().__init__(project)
        self._session: Renewed[MeasureSession] = Renewed(self._open)

    def session(self) -> MeasureSession:
        """The project opened for measuring, with the poses of the last run.

        Raises
        ------
        InputError
            If no photo has a pose yet.
        """
        return self._session.get(runs_done(self.project))

    def _open(self) -> MeasureSession:
        from processing_algorithms.measure.session import MeasureSession

        return MeasureSession.open(self.project)


def marks_of(vertices: Sequence[VertexRequest]) -> list[Mark]:
    """Marks, those of one vertex under its number."""
    from georef_gis.model.control import Mark

    return [
        Mark(
            name=str(number),
            photo=click.photo,
            u=click.u,
            v=click.v,
            sigma_px=CLICK if click.sigma_px is None else click.sigma_px,
            shared_px=click.shared_px,
            on_ground=click.on_ground,
        )
        for number, vertex in enumerate(vertices)
        for click in vertex.clicks
    ]


def ring_of(ellipse: Ellipse, centre: Sequence[float], unit: float) -> list[list[float]]:
    """Ring of an ellipse on the map."""
    ring: list[list[float]] = ellipse.polygon(centre, n=48, unit=unit).tolist()
    return ring


def told_points(points: MeasuredPoints) -> list[dict[str, Any]]:
    """Points with their ellipse and rays, for a page."""
    from georef_gis.measure.ellipses import ellipses_of, map_unit
    from processing_algorithms.measure.point_table import point_rows

    frame = points.scene.frame
    unit, ellipses = map_unit(frame), ellipses_of(frame, points, conf=CONF)
    out = []
    for row, point, ellipse in zip(point_rows(points, conf=CONF), points, ellipses, strict=True):
        rays = [
            {
                "photo": photo,
                "u": float(point.uv[k, 0]),
                "v": float(point.uv[k, 1]),
                "sigma_px": float(point.sigma_px[k]),
                "used": bool(point.used[k]),
                "residual_px": [float(r) for r in point.residuals[k]],
                "normalised": float(point.normalised[k]),
            }
            for k, photo in enumerate(point.photo_ids)
        ]
        for name in ("photo", "u", "v", "photos", "pixels", "sigma_px"):
            row.pop(name)
        row["doubts"] = list(point.doubts)
        ring = ring_of(ellipse, (row["easting"], row["northing"]), unit)
        out.append({**row, "rays": rays, "ellipse": ring})
    return out


def told_sight(sight: Sighting) -> dict[str, Any]:
    """A predicted pixel with its ellipse of one sigma."""
    import math

    return {
        "photo": sight.photo_id,
        "u": float(sight.uv[0]),
        "v": float(sight.uv[1]),
        "semi_major": sight.semi_major,
        "semi_minor": sight.semi_minor,
        "azimuth_deg": math.degrees(sight.azimuth),
        "gsd_m": sight.gsd,
        "from_middle": sight.from_middle,
    }
