"""Service `view`: what a page shows of a project; nothing here changes it."""

from __future__ import annotations

import contextlib
import math
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from georef_gis.errors import GeorefError, InputError
from georef_gis.toolbox.services import Picture, Renewed, Request, Service, call, picture
from processing_algorithms.state import file_state, runs_done
from processing_algorithms.view.layers import best_poses, layer

if TYPE_CHECKING:
    from georef_gis.project import Project
    from georef_gis.rasters.map_tiles import MapTiles
    from georef_gis.rasters.photo_tiles import PhotoTiles
    from georef_gis.rasters.screen import ScreenPicture
    from processing_algorithms.site import Site

# Maps by the name they are asked for, which is never a path.
MAPS = {"mosaic": "mosaic.tif"}
REPORT = "report.html"
LONGEST_ID = 500


class FactsRequest(Request):
    """Nothing to ask for."""


class LayerRequest(Request):
    """A layer by name."""

    name: str = Field(max_length=40)


class PhotoRequest(Request):
    """A photo by its id."""

    photo: str = Field(max_length=LONGEST_ID)


class MapTileRequest(Request):
    """A tile of a map: level 0 has its finest pixels."""

    name: str = Field(max_length=40)
    z: int = Field(ge=0, le=30)
    x: int = Field(ge=0, le=10_000_000)
    y: int = Field(ge=0, le=10_000_000)
    v: str = Field(default="", max_length=40, description="revision, to leave old caches behind")


class PhotoTileRequest(PhotoRequest):
    """A tile of a photo: level 0 has its own pixels."""

    z: int = Field(ge=0, le=12)
    x: int = Field(ge=0, le=10_000)
    y: int = Field(ge=0, le=10_000)
    v: str = Field(default="", max_length=40)


class ViewService(Service):
    """Facts, layers and tiles of a project."""

    def __init__(self, project: Project) -> None:
        super().__init__(project)
        self._lock = threading.Lock()
        self._maps: dict[str, MapTiles] = {}
        self._photos: PhotoTiles | None = None
        self._site: Renewed[Site] = Renewed(self._load)
        self._files: tuple[str, dict[str, Path]] = ("", {})

    def prepare(self) -> None:
        """Open the maps and read the poses."""
        self.facts(FactsRequest())
        self._oriented()

    def close(self) -> None:
        """Close the maps and forget the photos."""
        with self._lock:
            for tiles in self._maps.values():
                tiles.close()
            self._maps.clear()
            if self._photos is not None:
                self._photos.close()

    def revisions(self) -> dict[str, str]:
        """State of the project's runs and of its maps."""
        maps = {name: file_state(self.project.products / file) for name, file in MAPS.items()}
        report = file_state(self.project.products / REPORT)
        return {"project": runs_done(self.project), **maps, "report": report}

    # -- facts -----------------------------------------------------------------------------------

    @call(FactsRequest)
    def facts(self, request: FactsRequest) -> dict[str, Any]:
        """What the page must know first; `why_not` where there is nothing to show yet."""
        project = self.project
        out: dict[str, Any] = {
            "name": project.settings.project.name or project.folder.name,
            "revisions": self.revisions(),
            "report": (project.products / REPORT).is_file(),
            "map": None,
        }
        try:
            out |= self._site_facts()
        except GeorefError as error:
            # Whose file it is about goes without saying.
            source = getattr(error, "source", "")
            return out | {"why_not": str(error).removeprefix(f"{source}: ")}
        try:
            out["map"] = self._map_facts("mosaic")
        except InputError as error:
            out["map_why_not"] = str(error)
        return out

    def _site_facts(self) -> dict[str, Any]:
        from georef_gis.geodesy import metres_per_unit
        from georef_gis.project.records import load_frame

        database = self.project.database
        frame = load_frame(database)
        unit = metres_per_unit(frame.horizontal)
        photos, poses = database.rows("photo"), best_poses(self.project)
        kinds = [pose["kind"] for pose in poses.values()]
        gsd = sorted(row["gsd_m"] for row in database.rows("footprint") if row["gsd_m"])
        return {
            "crs": {
                "name": frame.crs.name, "code": frame.crs.to_epsg(), "metres_per_unit": unit,
                "unit": _unit_name(unit), "datum": str(frame.crs_datum),
            },
            "extent": self._extent(),
            "photos": len(photos),
            "photos_in_order": [row["photo_id"] for row in photos if row["photo_id"] in poses],
            "poses": {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)},
            "gsd_m": gsd[len(gsd) // 2] if gsd else None,
            "doubts": self._doubts(),
        }  # fmt: skip

    def _extent(self) -> list[float] | None:
        """West, south, east, north of what there is to see, CRS units."""
        for name in ("footprints", "photos"):
            rings = [f["geometry"]["coordinates"] for f in layer(self.project, name)["features"]]
            points = [p for ring in rings for p in _points(ring)]
            if points:
                xs, ys = zip(*points, strict=True)
                return [min(xs), min(ys), max(xs), max(ys)]
        return None

    def _doubts(self) -> list[str]:
        """What the last run of each tool called doubtful."""
        rows = self.project.database.last_rows("run", "tool")
        found = [d for row in rows for d in ((row["summary"] or {}).get("doubts") or ())]
        return list(dict.fromkeys(map(str, found)))[:200]

    def _map_facts(self, name: str) -> dict[str, Any] | None:
        path = self.project.products / MAPS[name]
        if not path.is_file():
            return None
        pyramid = self._map(name).pyramid
        a, _, c, _, _, f = pyramid.transform
        return {
            "name": name,
            "extent": pyramid.extent,
            "origin": [c, f],
            "resolution": a,
            "tile_size": pyramid.tile_size,
            "levels": [
                {"factor": factor, "width": width, "height": height}
                for factor, width, height in pyramid.levels
            ],
        }

    @call(LayerRequest)
    def layer(self, request: LayerRequest) -> dict[str, Any]:
        """A layer as GeoJSON in the project CRS."""
        return layer(self.project, request.name)

    # -- photos ----------------------------------------------------------------------------------

    @call(PhotoRequest)
    def photo(self, request: PhotoRequest) -> dict[str, Any]:
        """Size, zooms and directions of a photo."""
        from georef_gis.rasters.photo_tiles import TILE, zoom_levels

        photo = self._oriented().photos.get(request.photo)
        if photo is None:
            raise InputError(f"no photo {request.photo[:60]!r} has a pose; run `georef run`")
        width, height = photo.photo.width, photo.photo.height
        return {
            "photo": photo.id,
            "name": photo.photo.path.name,
            "width": width,
            "height": height,
            "tile_size": TILE,
            "levels": zoom_levels(width, height),
            "there": photo.photo.path.is_file(),
            "north_deg": self._north(request.photo),
            "tilt_deg": math.degrees(photo.pose.tilt),
            "pose": photo.pose.kind,
            "sigma_h_m": math.sqrt(float(photo.pose.covariance[:2, :2].trace()) / 2.0),
            "sigma_v_m": photo.pose.sigma_height,
        }

    def _north(self, photo_id: str) -> float | None:
        """Direction of grid north at the middle, degrees clockwise from the top of the photo."""
        import numpy as np

        site = self._oriented()
        photo = site.photos[photo_id]
        camera = photo.camera
        # Where the horizon is in sight, the middle may show the sky.
        for share in (0.5, 0.75, 1.0):
            uv = np.array([(camera.width - 1) * 0.5, (camera.height - 1) * share])
            start, ray = photo.rays(uv)
            with contextlib.suppress(GeorefError):
                p_enu = site.terrain.intersect(start, ray)
                if not np.all(np.isfinite(p_enu)):
                    continue
                p_map = site.frame.map_from_enu(p_enu)
                p_map[1] += 1.0 / site.gsd_unit
                north = site.frame.enu_from_map(p_map)
                du, dv = photo.project(north) - photo.project(p_enu)
                return math.degrees(math.atan2(du, -dv)) % 360.0
        return None

    def _oriented(self) -> Site:
        return self._site.get(runs_done(self.project))

    def _load(self) -> Site:
        from processing_algorithms.site import load_site

        return load_site(self.project)

    # -- pictures --------------------------------------------------------------------------------

    @picture(MapTileRequest)
    def map_tile(self, request: MapTileRequest) -> Picture:
        """A tile of a map, from its own pyramid."""
        if request.name not in MAPS:
            raise InputError(f"no map {request.name!r}; maps are {', '.join(MAPS)}")
        return _picture(self._map(request.name).tile(request.z, request.x, request.y))

    @picture(PhotoTileRequest)
    def photo_tile(self, request: PhotoTileRequest) -> Picture:
        """A tile of a photo as stored."""
        from georef_gis.rasters.photo_tiles import PhotoTiles

        path = self._photo_files().get(request.photo)
        if path is None:
            raise InputError(f"no photo {request.photo[:60]!r}")
        with self._lock:
            if self._photos is None:
                self._photos = PhotoTiles()
        return _picture(self._photos.tile(path, request.z, request.x, request.y))

    @call(FactsRequest)
    def report_state(self, request: FactsRequest) -> dict[str, Any]:
        """Which report there is, and what is newer than it, in words."""
        from processing_algorithms.view.report_age import older_than

        revision = file_state(self.project.products / REPORT)
        return {"revision": revision, "older_than": older_than(self.project) if revision else []}

    @picture(FactsRequest)
    def report(self, request: FactsRequest) -> Picture:
        """The report page."""
        try:
            content = (self.project.products / REPORT).read_bytes()
        except OSError as error:
            raise InputError("there is no report yet; run the tool `report`") from error
        return Picture(content=content, media_type="text/html; charset=utf-8")

    def _photo_files(self) -> dict[str, Path]:
        """Photo id -> file; a page names ids only."""
        revision = runs_done(self.project)
        with self._lock:
            if self._files[0] != revision or not self._files[1]:
                rows = self.project.database.rows("photo")
                self._files = revision, {row["photo_id"]: Path(row["path"]) for row in rows}
            return self._files[1]

    def _map(self, name: str) -> MapTiles:
        from georef_gis.rasters.map_tiles import MapTiles

        with self._lock:
            tiles = self._maps.get(name)
            if tiles is None or not tiles.is_current:
                self._maps[name] = tiles = MapTiles(self.project.products / MAPS[name])
            return tiles


def _picture(made: ScreenPicture) -> Picture:
    return Picture(content=made.content, media_type=made.media_type)


def _points(coordinates: Any) -> list[tuple[float, float]]:
    if not isinstance(coordinates[0], list):
        return [(coordinates[0], coordinates[1])]
    return [point for part in coordinates for point in _points(part)]


def _unit_name(metres: float) -> str:
    known = {1.0: "m", 0.3048: "ft", 1200.0 / 3937.0: "ftUS"}
    return next((name for value, name in known.items() if abs(metres - value) < 1e-9), "units")
