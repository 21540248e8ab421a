"""Call of the service `measure` that matches the clicks of a vertex into other photos."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import Field

from georef_gis.toolbox.services import call
from processing_algorithms.measure.service.base import (
    MOST_CLICKS,
    SessionService,
    VertexRequest,
    marks_of,
    told_points,
)

if TYPE_CHECKING:
    from georef_gis.measure.click_match.match import Matched
    from georef_gis.measure.measured import MeasuredPoints
    from georef_gis.model.control import Mark


class MatchRequest(VertexRequest):
    """The clicks of one vertex, and into which photos to match them: by default the best ones."""

    photos: tuple[str, ...] | None = Field(default=None, max_length=MOST_CLICKS)
    most: int = Field(default=8, ge=1, le=20)


class MatchCalls(SessionService):
    """Clicks matched into other photos."""

    @call(MatchRequest)
    def match(self, request: MatchRequest) -> dict[str, Any]:
        """Find what was clicked in the photos beside it, and place it by all of them.

        Asked with the clicks of ONE vertex. The answer holds

        - ``clicks``: the vertex's clicks from now on, the user's own first, where several of them
          show the spot at the pixel that they mean together, then the matches, best first, each
          with ``photo, u, v, sigma_px, shared_px, on_ground`` (send them back with the click: all
          share the user's error), ``matched``, ``sigma_match_px`` (of the match alone) and
          ``quality`` (correlation); the last two null for own clicks;
        - ``place`` and ``before``: with and without the matches, like a point of `figure`, or null;
        - ``template``: the photo and the side of the patch, px, that was matched, or null;
        - ``refused``: photos in which it was not found, and why: hints, not errors;
        - ``why_not``: why nothing was matched, or null; ``clicks`` are the old ones then;
        - ``doubts``: one line each.
        """
        from processing_algorithms.measure.matching import match_marks

        session = self.session()
        found = match_marks(
            session, marks_of([request]), photos=request.photos, most=request.most
        )  # fmt: skip
        return {
            "template": {"photo": found.template.photo, "size_px": found.size}
            if found.size
            else None,
            "clicks": _told_clicks(found),
            "refused": [{"photo": key, "why": why} for key, why in found.refused.items()],
            "why_not": found.why_not or None,
            "place": found.place and _told(found.place),
            "before": _told(found.before),
            "doubts": list(found.doubts),
        }


def _told(points: MeasuredPoints) -> dict[str, Any]:
    (told,) = told_points(points)
    return told


def _told_clicks(found: Matched) -> list[dict[str, Any]]:
    own = [
        {**_told_mark(mark), "matched": False, "sigma_match_px": None, "quality": None}
        for mark in found.own or found.clicks
    ]
    matched = [
        {**_told_mark(one.mark), "matched": True, "sigma_match_px": one.sigma_px,
         "quality": one.quality}
        for one in found.matches
    ]  # fmt: skip
    return own + matched


def _told_mark(mark: Mark) -> dict[str, Any]:
    return {"photo": mark.photo, "u": mark.u, "v": mark.v, "sigma_px": mark.sigma_px,
            "shared_px": mark.shared_px, "on_ground": mark.on_ground}  # fmt: skip
