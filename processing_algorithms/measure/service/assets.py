"""Calls of the service `measure` about assets: classes, list, edits, undo."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pydantic import Field

from georef_gis.errors import GeometryError, InputError
from georef_gis.toolbox.services import ConflictError, Request, call
from processing_algorithms.measure.marks import CLICK
from processing_algorithms.measure.service.base import (
    LONGEST_ID,
    LONGEST_TEXT,
    MOST_CLICKS,
    MOST_VERTICES,
    NothingRequest,
    SessionService,
    VertexRequest,
    ring_of,
)
from processing_algorithms.state import file_state, runs_done

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.measure.assets.asset import Asset, Click, Quality, Vertex
    from georef_gis.measure.assets.ledger import Step
    from georef_gis.measure.assets.store import AssetStore
    from georef_gis.measure.measured import MeasuredPoints
    from processing_algorithms.assets.asset_clicks import Clicked

# steps of the history that are told
_MOST_STEPS = 50


class AddRequest(Request):
    """A new asset by the clicks of its vertices."""

    kind: str = Field(max_length=100)
    name: str = Field(default="", max_length=LONGEST_TEXT)
    note: str = Field(default="", max_length=LONGEST_TEXT)
    attributes: dict[str, Any] = Field(default_factory=dict, max_length=200)
    vertices: tuple[VertexRequest, ...] = Field(min_length=1, max_length=MOST_VERTICES)


class ChangeRequest(Request):
    """What is to change in an asset, and the state it was changed from."""

    id: str = Field(max_length=LONGEST_ID)
    revision: int = Field(ge=0)
    kind: str | None = Field(default=None, max_length=100)
    name: str | None = Field(default=None, max_length=LONGEST_TEXT)
    note: str | None = Field(default=None, max_length=LONGEST_TEXT)
    attributes: dict[str, Any] | None = Field(default=None, max_length=200)
    vertices: tuple[VertexRequest, ...] | None = Field(default=None, max_length=MOST_VERTICES)


class DeleteRequest(Request):
    """An asset to delete, and the state it was seen in."""

    id: str = Field(max_length=LONGEST_ID)
    revision: int = Field(ge=0)


class AssetCalls(SessionService):
    """Assets of the project."""

    _store: AssetStore | None = None
    # state of the file and of the poses, assets that have clicks, and their points
    _measured: tuple[tuple[str, str], list[Asset], MeasuredPoints | None] | None = None

    def store(self) -> AssetStore:
        """Store of the assets, which is opened once."""
        from georef_gis.measure.assets.store import AssetStore

        with self._store_lock:
            if self._store is None:
                self._store = AssetStore.of_project(self.project)
            return self._store

    _store_lock = threading.Lock()

    def asset_revision(self) -> str:
        """Text that changes with the file of the assets."""
        return file_state(self.project.folder / "assets.gpkg")

    def close(self) -> None:
        """Close the store."""
        super().close()
        if self._store is not None:
            self._store.close()

    # -- reading ---------------------------------------------------------------------------------

    @call(NothingRequest)
    def classes(self, request: NothingRequest) -> dict[str, Any]:
        """Classes of assets, from which forms are made."""
        return {"classes": self.store().domain.as_json()}

    @call(NothingRequest)
    def assets(self, request: NothingRequest) -> dict[str, Any]:
        """All assets, and what may be undone."""
        store, unit = self.store(), self.session().unit
        revision = self.asset_revision()
        assets = [told_asset(asset, unit) for asset in store.assets()]
        steps = [_told_step(step) for step in store.steps(_MOST_STEPS)]
        return {"assets": assets, "steps": steps, "revision": revision}

    # -- editing ---------------------------------------------------------------------------------

    @call(AddRequest)
    def add_asset(self, request: AddRequest) -> dict[str, Any]:
        """Measure what was clicked and store it."""
        one = _clicked(request.kind, request.name, request.note, request.attributes,
                       request.vertices)  # fmt: skip
        draft, doubts = self._measure(one)
        asset = self.store().add(draft)
        return {"asset": told_asset(asset, self.session().unit), "doubts": doubts}

    @call(ChangeRequest)
    def change_asset(self, request: ChangeRequest) -> dict[str, Any]:
        """Change an asset; with vertices it is measured anew."""
        from georef_gis.measure.assets.asset import StaleAssetError
        from georef_gis.measure.assets.store import Change

        quality: Quality | None = None
        vertices: tuple[Vertex, ...] | None = None
        doubts: list[str] = []
        if request.vertices is not None:
            kind = request.kind or self.store().get(request.id).kind
            draft, doubts = self._measure(_clicked(kind, "", "", {}, request.vertices))
            vertices, quality = draft.vertices, draft.quality
        change = Change(
            kind=request.kind, name=request.name, note=request.note,
            attributes=request.attributes, vertices=vertices, quality=quality,
        )  # fmt: skip
        try:
            asset = self.store().change(request.id, request.revision, change)
        except StaleAssetError as error:
            raise self._conflict(error) from error
        return {"asset": told_asset(asset, self.session().unit), "doubts": doubts}

    @call(DeleteRequest)
    def delete_asset(self, request: DeleteRequest) -> dict[str, Any]:
        """Delete an asset; it can be undone."""
        from georef_gis.measure.assets.asset import StaleAssetError

        try:
            self.store().delete(request.id, request.revision)
        except StaleAssetError as error:
            raise self._conflict(error) from error
        return {}

    @call(NothingRequest)
    def undo(self, request: NothingRequest) -> dict[str, Any]:
        """Undo the last step; `step` is null if there is none."""
        step = self.store().undo()
        return {"step": step and _told_step(step)}

    @call(NothingRequest)
    def redo(self, request: NothingRequest) -> dict[str, Any]:
        """Do again what was undone last."""
        step = self.store().redo()
        return {"step": step and _told_step(step)}

    def _measure(self, one: Clicked) -> tuple[Any, list[str]]:
        from processing_algorithms.assets.asset_clicks import measure_clicked

        (found,) = measure_clicked(self.session(), [one], sigma_px=CLICK)
        if found.draft is None:
            raise GeometryError(found.refused)
        return found.draft, list(found.doubts)

    def _conflict(self, error: Any) -> ConflictError:
        current = error.current and told_asset(error.current, self.session().unit)
        # The path of the file tells the page's user nothing.
        text = str(error).removeprefix(f"{error.source}: {error.field}: ")
        return ConflictError(text, current=current)

    # -- in a photo ------------------------------------------------------------------------------

    def assets_in(self, photo_id: str) -> list[dict[str, Any]]:
        """Where a photo shows the assets: points in it, lines and areas in it or near it."""
        import numpy as np

        session = self.session()
        scene, number = session.scene, self.session().scene.number(photo_id)
        camera = scene.photos.photos[number].camera
        size = np.array([camera.width, camera.height])
        out = []
        for asset in self.store().assets():
            if not asset.vertices:
                continue
            p_enu = self._places(asset)
            uv = scene.photos.project(np.full(len(p_enu), number), p_enu)
            beyond = (0.0 if asset.shape == "point" else 0.5 * size.max()) - 0.5
            if np.isfinite(uv).all() and (uv > -1.0 - beyond).all() and (uv < size + beyond).all():
                told = {"id": asset.id, "shape": asset.shape, "uv": uv.tolist()}
                out.append(told | self._ellipse_in(asset, number))
        return out

    def _places(self, asset: Asset) -> Array:
        """Vertices in enu; one whose height is not known lies on the ground."""
        import numpy as np

        session = self.session()
        p_map = np.array(asset.vertices, dtype=np.float64)
        unknown = np.isnan(p_map[:, 2])
        if unknown.any():
            ground = session.scene.terrain.height_on_map(session.frame, p_map[unknown, :2])
            p_map[unknown, 2] = ground
        return np.asarray(session.frame.enu_from_map(p_map))

    def _ellipse_in(self, asset: Asset, photo: int) -> dict[str, float]:
        """Ellipse of one sigma of a point in a photo, px; none without clicks.

        From the clicks: poses err alike for the asset and for the photo that shows it.
        """
        import numpy as np

        from georef_gis.measure.predicting import predict_measured

        assets, points = self._clicked_points()
        index = next((i for i, one in enumerate(assets) if one.id == asset.id), None)
        if points is None or index is None or str(index) not in points.names:
            return {}
        found = predict_measured(points, points.names.index(str(index)), np.array([photo]))
        if not np.isfinite(found.covariance).all():
            return {}
        values, vectors = np.linalg.eigh(found.covariance[0])
        minor, major = np.sqrt(np.maximum(values, 0.0))
        right, down = vectors[:, 1]
        azimuth = math.degrees(math.atan2(right, -down)) % 180.0
        return {"semi_major": float(major), "semi_minor": float(minor), "azimuth_deg": azimuth}

    def _clicked_points(self) -> tuple[list[Asset], MeasuredPoints | None]:
        """Point assets that have clicks, and their points, measured once for each state."""
        from processing_algorithms.assets.asset_clicks import is_clicked, mark_of

        state = self.asset_revision(), runs_done(self.project)
        kept = self._measured
        if kept is not None and kept[0] == state:
            return kept[1], kept[2]
        session = self.session()
        known = session.site.photos
        chosen = [
            asset
            for asset in self.store().assets()
            if asset.shape == "point" and asset.quality and is_clicked(asset)
            and all(click.photo_id in known for click in asset.quality.clicks)
        ]  # fmt: skip
        marks = [
            mark_of(str(i), click, CLICK)
            for i, asset in enumerate(chosen) if asset.quality for click in asset.quality.clicks
        ]  # fmt: skip
        points = session.measure(marks, on_fail="skip") if marks else None
        self._measured = state, chosen, points
        return chosen, points


def _clicked(
    kind: str, name: str, note: str, attributes: dict[str, Any], vertices: Sequence[VertexRequest]
) -> Clicked:
    from georef_gis.measure.assets.asset import Click
    from processing_algorithms.assets.asset_clicks import Clicked

    clicks: list[Click] = [
        Click(photo_id=c.photo, u=c.u, v=c.v, vertex=number, sigma_px=c.sigma_px,
              shared_px=c.shared_px, on_ground=c.on_ground)
        for number, vertex in enumerate(vertices)
        for c in vertex.clicks
    ]  # fmt: skip
    if len(clicks) > 10 * MOST_CLICKS:
        raise InputError(f"{len(clicks)} clicks, more than {10 * MOST_CLICKS}; use fewer")
    return Clicked(kind=kind, name=name, note=note, attributes=attributes, clicks=tuple(clicks))


def told_asset(asset: Asset, unit: float) -> dict[str, Any]:
    """An asset as a page takes it; `unit` is m per CRS unit."""
    quality = asset.quality
    out: dict[str, Any] = {
        "id": asset.id, "kind": asset.kind, "shape": asset.shape, "name": asset.name,
        "note": asset.note, "attributes": dict(asset.attributes), "revision": asset.revision,
        "created": asset.created, "changed": asset.changed, "problems": list(asset.problems),
        "vertices": [[x, y, None if math.isnan(z) else z] for x, y, z in asset.vertices],
        "quality": None, "ellipse": None, "clicks": [],
    }  # fmt: skip
    if quality is None:
        return out
    names = ("sigma_e", "sigma_n", "sigma_u", "corr_en", "semi_major", "semi_minor", "azimuth",
             "conf", "dof", "n_rays", "method")  # fmt: skip
    out["quality"] = {name: getattr(quality, name) for name in names}
    out["clicks"] = [
        {"photo": c.photo_id, "u": c.u, "v": c.v, "vertex": c.vertex, "sigma_px": c.sigma_px,
         "shared_px": c.shared_px, "on_ground": c.on_ground}
        for c in quality.clicks
    ]  # fmt: skip
    out["ellipse"] = _ring(asset, quality, unit)
    return out


def _ring(asset: Asset, quality: Quality, unit: float) -> list[list[float]] | None:
    from georef_gis.measure.ellipses import Ellipse

    axes = quality.semi_major, quality.semi_minor, quality.azimuth
    if asset.shape != "point" or not asset.vertices or any(axis is None for axis in axes):
        return None
    major, minor, azimuth = (float(axis) for axis in axes if axis is not None)
    ellipse = Ellipse(semi_major=major, semi_minor=minor, azimuth=math.radians(azimuth))
    return ring_of(ellipse, asset.vertices[0][:2], unit)


def _told_step(step: Step) -> dict[str, Any]:
    return {"title": step.title, "at": step.at, "state": step.state,
            "assets": list(step.asset_ids)}  # fmt: skip
