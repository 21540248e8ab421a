"""Service `measure`: what a page does with the clicks of its user."""

from __future__ import annotations

from typing import Any

from georef_gis.toolbox.services import call
from processing_algorithms.measure.service.assets import AssetCalls
from processing_algorithms.measure.service.base import PhotoRequest
from processing_algorithms.measure.service.control import ControlCalls
from processing_algorithms.measure.service.figures import FigureCalls, FigureRequest
from processing_algorithms.measure.service.matching import MatchCalls


class MeasureService(FigureCalls, MatchCalls, AssetCalls, ControlCalls):
    """Points, lengths, assets, and marks of control points."""

    def revisions(self) -> dict[str, str]:
        """State of the assets and of the control."""
        return {"assets": self.asset_revision(), "control": self.control_revision()}

    def prepare(self) -> None:
        """Open the session, the assets and the control; place one click, which loads the rest."""
        session = self.session()
        self.store()
        photo = next(iter(session.site.photos.values()))
        click = {"photo": photo.id, "u": photo.camera.width / 2, "v": photo.camera.height / 2}
        self.figure(
            FigureRequest.model_validate({"shape": "point", "vertices": [{"clicks": [click]}]})
        )
        self.control_in(photo.id)

    @call(PhotoRequest)
    def in_photo(self, request: PhotoRequest) -> dict[str, Any]:
        """Predicted pixels of assets and control points in a photo."""
        return {
            "assets": self.assets_in(request.photo),
            "control": self.control_in(request.photo),
        }
