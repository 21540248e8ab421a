"""Layers that are exported: names, units and meaning of their attributes, decided here once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# Layers of mapped assets, the last one of their error ellipses
ELLIPSES = "asset_ellipses"
ASSETS = ("asset_points", "asset_lines", "asset_polygons", ELLIPSES)

FieldKind = Literal["text", "real", "integer", "flag"]
GeometryKind = Literal["Point", "LineString", "Polygon", "None"]
Value = str | float | int | bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """An attribute: the unit stands in its name, and again in `unit`."""

    name: str
    kind: FieldKind
    unit: str
    doc: str


def _fields(*rows: tuple[str, FieldKind, str, str]) -> tuple[Field, ...]:
    return tuple(Field(name=name, kind=kind, unit=unit, doc=doc) for name, kind, unit, doc in rows)


PHOTO_FIELDS = _fields(
    ("photo", "text", "", "Id of the photo"),
    ("file", "text", "", "File name of the photo"),
    ("flight", "text", "", "Id of the flight"),
    ("camera", "text", "", "Id of the camera whose values go with the pose"),
    ("time_utc", "text", "", "Time of exposure, UTC, ISO 8601; empty if only the camera's clock"),
    ("camera_clock", "text", "", "Time as the camera's own clock says, no time zone"),
    ("lon_deg", "real", "deg", "Longitude of the projection centre"),
    ("lat_deg", "real", "deg", "Latitude of the projection centre"),
    ("height_ellipsoidal_m", "real", "m", "Height above the WGS 84 ellipsoid"),
    ("height_orthometric_m", "real", "m", "Height above the EGM96 geoid"),
    ("height_above_ground_m", "real", "m", "Height above the ground below"),
    ("height_kind", "text", "", "What the heights above ellipsoid and geoid rest on, in words"),
    ("roll_deg", "real", "deg", "Roll of the camera, 0 at nadir; with yaw, pitch as Rz Ry Rx"),
    ("pitch_deg", "real", "deg", "Pitch of the camera, 0 at nadir, nose up positive"),
    ("yaw_deg", "real", "deg", "Direction of the image's top, clockwise from true north"),
    ("omega_deg", "real", "deg", "Omega of Rx(omega) Ry(phi) Rz(kappa), map from photo axes"),
    ("phi_deg", "real", "deg", "Phi, as above"),
    ("kappa_deg", "real", "deg", "Kappa, as above; from grid east, counter-clockwise"),
    ("sigma_e_m", "real", "m", "One sigma of the position towards true east"),
    ("sigma_n_m", "real", "m", "One sigma of the position towards true north"),
    ("sigma_u_m", "real", "m", "One sigma of the height above ellipsoid and geoid"),
    ("sigma_above_ground_m", "real", "m", "One sigma of the height above the ground"),
    ("corr_en", "real", "1", "Correlation of the errors in east and north"),
    ("sigma_major_m", "real", "m", "Semi-major axis of the one-sigma ellipse (39 % inside)"),
    ("sigma_minor_m", "real", "m", "Semi-minor axis of the one-sigma ellipse"),
    ("sigma_azimuth_deg", "real", "deg", "Azimuth of the major axis from true north, 0 to 180"),
    ("sigma_roll_deg", "real", "deg", "One sigma of roll"),
    ("sigma_pitch_deg", "real", "deg", "One sigma of pitch"),
    ("sigma_yaw_deg", "real", "deg", "One sigma of yaw"),
    ("sigma_omega_deg", "real", "deg", "One sigma of omega"),
    ("sigma_phi_deg", "real", "deg", "One sigma of phi"),
    ("sigma_kappa_deg", "real", "deg", "One sigma of kappa"),
    ("pose_kind", "text", "", "Where the pose is from: tags, navigation or adjusted; empty = none"),
    (
        "turned_deg",
        "integer",
        "deg",
        "By how much the pixels were turned clockwise after exposure; "
        "the camera's values are those before",
    ),
    ("tie_points", "integer", "", "Number of tie points that the adjustment used in the photo"),
    ("residual_px", "real", "px", "Root mean square residual of a coordinate of its tie points"),
    ("gsd_m", "real", "m", "Mean ground sample distance of the photo"),
    ("tilt_deg", "real", "deg", "Angle of the view axis off nadir"),
    ("doubts", "text", "", "What is doubtful about the photo, parted by semicolons"),
)
FOOTPRINT_FIELDS = _fields(
    ("photo", "text", "", "Id of the photo"),
    ("gsd_m", "real", "m", "Mean ground sample distance"),
    ("gsd_min_m", "real", "m", "Smallest ground sample distance in the photo"),
    ("gsd_max_m", "real", "m", "Largest ground sample distance in the photo"),
    ("area_m2", "real", "m2", "Area of ground that the photo shows"),
    ("height_above_ground_m", "real", "m", "Height of the camera above the ground"),
    ("tilt_deg", "real", "deg", "Angle of the view axis off nadir"),
    ("sigma_horizontal_m", "real", "m", "One sigma per axis of the place of the photo's middle"),
    ("clipped", "flag", "", "Whether the photo also looks above the horizon or past the ground"),
)
TRACK_FIELDS = _fields(
    ("flight", "text", "", "Id of the flight"),
    ("part", "integer", "", "Number of the part; a flight is split where photos are far apart"),
    ("photos", "integer", "", "Number of photos"),
    ("first_photo", "text", "", "Id of the first photo"),
    ("last_photo", "text", "", "Id of the last photo"),
    ("start_utc", "text", "", "Time of the first photo, UTC, ISO 8601"),
    ("end_utc", "text", "", "Time of the last photo, UTC, ISO 8601"),
    ("duration_s", "real", "s", "From the first to the last photo"),
    ("length_m", "real", "m", "Length in space from photo to photo"),
)
CAMERA_FIELDS = _fields(
    ("camera", "text", "", "Id of the camera"),
    ("model", "text", "", "Lens model: brown, brown_inverse, fisheye or fisheye_pix4d"),
    ("width_px", "integer", "px", "Width of the photos"),
    ("height_px", "integer", "px", "Height of the photos"),
    ("fx_px", "real", "px", "Focal length along u"),
    ("fy_px", "real", "px", "Focal length along v"),
    ("cx_px", "real", "px", "Principal point u; 0 = centre of the first pixel"),
    ("cy_px", "real", "px", "Principal point v"),
    ("k1", "real", "1", "Radial distortion, ideal to distorted (OpenCV)"),
    ("k2", "real", "1", "Radial distortion"),
    ("k3", "real", "1", "Radial distortion"),
    ("k4", "real", "1", "Radial distortion of a fisheye"),
    ("p1", "real", "1", "Decentring distortion"),
    ("p2", "real", "1", "Decentring distortion"),
    ("b1_px", "real", "px", "Affinity"),
    ("b2_px", "real", "px", "Skew"),
    ("sigma_f_px", "real", "px", "One sigma of the focal length"),
    ("sigma_c_px", "real", "px", "One sigma of the principal point, per axis"),
    ("readout_s", "real", "s", "From the first to the last row; 0 = a mechanical shutter"),
    ("photos", "integer", "", "Number of photos whose pose goes with it; 0 = not used"),
    ("source", "text", "", "Where the values come from"),
)
CONTROL_FIELDS = _fields(
    ("name", "text", "", "Name of the point"),
    ("role", "text", "", "control (used in an adjustment), check (tested only) or off"),
    ("lon_deg", "real", "deg", "Longitude as surveyed"),
    ("lat_deg", "real", "deg", "Latitude as surveyed"),
    ("height_ellipsoidal_m", "real", "m", "Surveyed height above the WGS 84 ellipsoid"),
    ("height_orthometric_m", "real", "m", "Surveyed height above the EGM96 geoid"),
    ("height_map", "real", "unit of the CRS", "Surveyed height as the CRS has it"),
    ("datum", "text", "", "Datum and epoch as the survey's file states them"),
    ("survey_sigma_h_m", "real", "m", "One sigma of the survey, per horizontal axis"),
    ("survey_sigma_v_m", "real", "m", "One sigma of the survey in height"),
    ("marks", "integer", "", "Number of photos in which it is marked"),
    ("rays", "integer", "", "Number of marks in the adjustment; empty = it took no part"),
    ("off_east_m", "real", "m", "Adjusted minus surveyed place, towards true east"),
    ("off_north_m", "real", "m", "Adjusted minus surveyed place, towards true north"),
    ("off_up_m", "real", "m", "Adjusted minus surveyed height"),
    ("sigma_e_m", "real", "m", "One sigma of the adjusted place towards true east"),
    ("sigma_n_m", "real", "m", "One sigma of the adjusted place towards true north"),
    ("sigma_u_m", "real", "m", "One sigma of the adjusted height"),
    ("residual_px", "real", "px", "Root mean square residual of a coordinate of its marks"),
)
TIE_POINT_FIELDS = _fields(
    ("point", "integer", "", "Number of the point"),
    ("lon_deg", "real", "deg", "Longitude"),
    ("lat_deg", "real", "deg", "Latitude"),
    ("height_ellipsoidal_m", "real", "m", "Height above the WGS 84 ellipsoid"),
    ("height_orthometric_m", "real", "m", "Height above the EGM96 geoid"),
    ("rays", "integer", "", "Number of photos that see it"),
    ("residual_px", "real", "px", "Root mean square residual of a coordinate of its pixels"),
    ("sigma_e_m", "real", "m", "One sigma towards true east, the poses' share included"),
    ("sigma_n_m", "real", "m", "One sigma towards true north, the poses' share included"),
    ("sigma_u_m", "real", "m", "One sigma of the heights above ellipsoid and geoid"),
    ("sigma_u_block_m", "real", "m", "The same without a level that cameras and ground share"),
)
ASSET_FIELDS = _fields(
    ("asset_id", "text", "", "Id of the asset"),
    ("class", "text", "", "Name of its class"),
    ("name", "text", "", "Name that it was given"),
    ("note", "text", "", "Note"),
    ("attributes", "text", "", "Attributes of its class, a JSON object"),
    ("lon_deg", "real", "deg", "Longitude of its first vertex"),
    ("lat_deg", "real", "deg", "Latitude of its first vertex"),
    ("height_ellipsoidal_m", "real", "m", "Height of its first vertex above the ellipsoid"),
    ("height_orthometric_m", "real", "m", "Height of its first vertex above the EGM96 geoid"),
    ("height_map", "real", "unit of the CRS", "The same as the CRS has heights"),
    ("sigma_e_m", "real", "m", "One sigma towards grid east, of the worst vertex"),
    ("sigma_n_m", "real", "m", "One sigma towards grid north, of the worst vertex"),
    ("sigma_u_m", "real", "m", "One sigma of the height, of the worst vertex"),
    ("corr_en", "real", "1", "Correlation of the errors in east and north"),
    ("semi_major_m", "real", "m", "Semi-major axis of the ellipse that holds the place"),
    ("semi_minor_m", "real", "m", "Semi-minor axis of that ellipse"),
    ("azimuth_deg", "real", "deg", "Azimuth of its major axis, clockwise from grid north"),
    ("conf", "real", "1", "Probability with which the ellipse holds the place"),
    ("dof", "integer", "", "Degrees of freedom of the measurement; 0 from one photo"),
    ("n_rays", "integer", "", "Number of photos it was measured in"),
    ("method", "text", "", "locate (one photo), intersect (several), or edited by hand"),
    ("photo_ids", "text", "", "Photos it was clicked in, a JSON list"),
    ("pixels", "text", "", "Its clicks, JSON: photo, u, v, vertex, sigma px"),
    ("created", "text", "", "When it was stored, UTC, ISO 8601"),
    ("changed", "text", "", "When it was changed last, UTC, ISO 8601"),
)
ELLIPSE_FIELDS = _fields(
    ("asset_id", "text", "", "Id of the asset"),
    ("class", "text", "", "Name of its class"),
    ("name", "text", "", "Name that it was given"),
    ("semi_major_m", "real", "m", "Semi-major axis"),
    ("semi_minor_m", "real", "m", "Semi-minor axis"),
    ("azimuth_deg", "real", "deg", "Azimuth of the major axis, clockwise from grid north"),
    ("conf", "real", "1", "Probability with which it holds the place"),
)
