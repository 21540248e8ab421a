"""A site's photos, footprints, cameras and control as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from georef_gis.frames import Array
from georef_gis.geodesy import CRS, MapFrame
from georef_gis.model.camera import Camera
from georef_gis.model.layers import Footprint
from georef_gis.model.photo import Photo
from georef_gis.model.pose import Pose
from georef_gis.project.asset_layers import AssetTable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SitePhoto:
    """A photo with what became of it; without a pose only its tagged position is known.

    Parameters
    ----------
    height_above_ground, sigma_above_ground : m
        One sigma of camera and ground together.
    posed_camera_id
        Id of the camera that the pose goes with; empty = that of the photo.
    turned_deg
        Degrees clockwise by which the pose takes the pixels as turned after the exposure.
    tie_points, residual_px
        How many tie points the adjustment used in the photo, and their root mean square residual.
    """

    photo: Photo
    pose: Pose | None = None
    height_above_ground: float | None = None
    sigma_above_ground: float | None = None
    doubts: tuple[str, ...] = ()
    posed_camera_id: str = ""
    turned_deg: int = 0
    tie_points: int | None = None
    residual_px: float | None = None

    @property
    def camera_id(self) -> str:
        """Id of the camera whose values go with the pose."""
        return self.posed_camera_id or self.photo.camera_id


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SiteControl:
    """A surveyed point, and what the adjustment made of it.

    Parameters
    ----------
    p_map : shape (3,)
        East, north in CRS units, height above the ellipsoid in m, NaN if not surveyed.
    sigma_h, sigma_v : m
        Of the survey; None = not stated.
    marks
        In how many photos it is marked.
    adjusted
        Its entry in the report of the adjustment; None = it took no part.
    """

    name: str
    role: str
    p_map: Array
    sigma_h: float | None = None
    sigma_v: float | None = None
    marks: int = 0
    datum: str = ""
    adjusted: Mapping[str, Any] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class SiteValues:
    """What a site has: photos, footprints, cameras, mosaic.

    Parameters
    ----------
    frame
        Between the project's enu and its CRS.
    epoch_gps
        The project's epoch, s on the GPS scale since 1980-01-06.
    mosaic
        File of the mosaic, if there is one.
    facts
        Name -> text, of the run and of the project.
    assets
        Mapped assets and their error ellipses, as `assets.gpkg` has them.
    adjustment
        Folder of the adjustment that most of the poses are from, if one is.
    accuracy
        Name -> text of the accuracy statement, if one was made of these products.
    warnings
        What is to be said of the site whatever is written of it.
    """

    name: str
    frame: MapFrame
    photos: tuple[SitePhoto, ...]
    footprints: tuple[Footprint, ...] = ()
    cameras: tuple[Camera, ...] = ()
    mosaic: Path | None = None
    epoch_gps: float = 0.0
    facts: Mapping[str, str] = field(default_factory=dict)
    control: tuple[SiteControl, ...] = ()
    assets: tuple[AssetTable, ...] = ()
    adjustment: Path | None = None
    accuracy: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def crs(self) -> CRS:
        """CRS of map coordinates: the horizontal part of the project's."""
        return self.frame.horizontal

    @property
    def crs_name(self) -> str:
        """Code of the CRS such as ``EPSG:32617``, else its name."""
        authority = self.crs.to_authority(min_confidence=100)
        return ":".join(authority) if authority else str(self.crs.name)

    @property
    def unplaced(self) -> tuple[str, ...]:
        """Ids of photos that have neither pose nor tagged position."""
        return tuple(p.photo.id for p in self.photos if p.pose is None and not p.photo.geotag)

    def metadata(self) -> dict[str, str]:
        """What someone who has only the file needs to know, by name."""
        from exports.site.map_heights import told_of_map_heights
        from georef_gis import __version__

        kinds = sorted({p.pose.kind for p in self.photos if p.pose})
        return {
            "title": self.name,
            "made_by": f"georef_gis {__version__}",
            "made_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            "crs": self.crs_name,
            "crs_name": str(self.crs.name),
            "crs_unit": str(self.crs.axis_info[0].unit_name),
            "crs_wkt": self.crs.to_wkt(),
            "datum_of_positions": str(self.frame.gnss_datum),
            "datum_of_crs": str(self.frame.crs_datum),
            "heights": "height_ellipsoidal_m is above the WGS 84 ellipsoid, height_orthometric_m "
            "above the EGM96 geoid, height_above_ground_m above the ground; all in metres; "
            "height_kind says what the first two rest on",
            "heights_of_map": told_of_map_heights(self.frame),
            "sigmas": "one standard deviation; sigma_u_m of the heights above ellipsoid and geoid, "
            "sigma_above_ground_m of that above the ground",
            "poses": ", ".join(kinds) or "none",
            "photos": str(len(self.photos)),
            "photos_without_place": ", ".join(self.unplaced),
            **self.facts,
            **{name.lower(): text for name, text in self.accuracy.items()},
        }
