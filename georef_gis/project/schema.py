"""Tables of the project database: the one place that names their columns."""

from __future__ import annotations

from dataclasses import dataclass

# Raised when a table changes; an older georef_gis refuses a newer database.
SCHEMA_NUMBER = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table: columns in order with their SQL type.

    JSON and PATH are TEXT, coded and decoded for you; a PATH of a file in the database's folder is
    kept relative to it, so that a project may be moved and copied.

    Parameters
    ----------
    key
        Columns that name a row uniquely; none = rows are only appended.
    geometry
        GeoPackage geometry type in the project CRS, empty for a plain table.
    """

    name: str
    description: str
    columns: dict[str, str]
    key: tuple[str, ...] = ()
    geometry: str = ""
    has_z: bool = False


TABLES: dict[str, Table] = {
    table.name: table
    for table in (
        Table(
            name="photo",
            description="Photos as ingested; the point is the tagged position",
            key=("photo_id",),
            geometry="POINT",
            has_z=True,
            columns={
                "photo_id": "TEXT", "flight_id": "TEXT", "camera_id": "TEXT", "mount_id": "TEXT",
                "name": "TEXT", "path": "PATH", "width": "INTEGER", "height": "INTEGER",
                "camera_clock": "TEXT", "clock_resolution_s": "REAL", "time_gps": "REAL",
                "time_sigma_s": "REAL", "time_source": "TEXT", "match_confidence": "REAL",
                "fingerprint": "TEXT", "tags": "JSON", "status": "TEXT", "doubts": "JSON",
            },
        ),
        Table(
            name="camera",
            description="Interior orientations, px; parameters in the order of the contract",
            key=("camera_id",),
            columns={
                "camera_id": "TEXT", "name": "TEXT", "model": "TEXT", "width": "INTEGER",
                "height": "INTEGER", "parameters": "JSON", "covariance": "JSON",
                "readout_s": "REAL", "source": "TEXT", "extra": "JSON",
            },
        ),
        Table(
            name="mount",
            description="Lever arms (m) and boresight (rad) in body axes",
            key=("mount_id",),
            columns={
                "mount_id": "TEXT", "lever_arm_camera": "JSON", "lever_arm_antenna": "JSON",
                "boresight": "JSON", "rotation_nominal": "JSON", "covariance": "JSON",
                "source": "TEXT", "extra": "JSON",
            },
        ),
        Table(
            name="flight",
            description="Flights: bias, clock and boresight that hold for all photos of one",
            key=("flight_id",),
            columns={
                "flight_id": "TEXT", "name": "TEXT", "start_gps": "REAL", "end_gps": "REAL",
                "clock_offset_s": "REAL", "clock_drift": "REAL", "clock_sigma_s": "REAL",
                "bias_enu": "JSON", "bias_covariance": "JSON", "boresight": "JSON",
                "extra": "JSON",
            },
        ),
        Table(
            name="pose",
            description="Exterior orientations: direct and adjusted ones side by side",
            key=("photo_id", "kind"),
            geometry="POINT",
            has_z=True,
            columns={
                "photo_id": "TEXT", "run_id": "INTEGER", "kind": "TEXT",
                "x_enu": "REAL", "y_enu": "REAL", "z_enu": "REAL",
                "rotation": "JSON", "covariance": "JSON", "time_gps": "REAL",
                "omega_deg": "REAL", "phi_deg": "REAL", "kappa_deg": "REAL",
                "yaw_deg": "REAL", "pitch_deg": "REAL", "roll_deg": "REAL",
                "sigma_h_m": "REAL", "sigma_v_m": "REAL", "height_above_ground_m": "REAL",
                "dialect": "TEXT", "status": "TEXT", "doubts": "JSON", "extra": "JSON",
            },
        ),
        Table(
            name="footprint",
            description="Ground each photo covers",
            key=("photo_id",),
            geometry="POLYGON",
            columns={
                "photo_id": "TEXT", "pose_kind": "TEXT", "gsd_m": "REAL", "area_m2": "REAL",
                "tilt_deg": "REAL", "sigma_m": "REAL", "status": "TEXT", "doubts": "JSON",
                "extra": "JSON",
            },
        ),
        Table(
            name="control",
            description="Control and check points as surveyed",
            key=("name",),
            geometry="POINT",
            has_z=True,
            columns={
                "name": "TEXT", "role": "TEXT", "easting": "REAL", "northing": "REAL",
                "height": "REAL", "height_kind": "TEXT", "sigma_h_m": "REAL", "sigma_v_m": "REAL",
                "crs": "TEXT", "datum": "TEXT", "extra": "JSON",
            },
        ),
        Table(
            name="mark",
            description="Pixels of control points in photos; (0, 0) = centre of the first pixel",
            key=("name", "photo_id"),
            columns={
                "name": "TEXT", "photo_id": "TEXT", "u": "REAL", "v": "REAL", "sigma_px": "REAL",
                "extra": "JSON",
            },
        ),
        Table(
            name="run",
            description="Every run of a tool: what went in, what came out",
            columns={
                "tool": "TEXT", "outcome": "TEXT", "started": "TEXT", "duration_s": "REAL",
                "parameters": "JSON", "settings": "JSON", "versions": "JSON", "quick": "INTEGER",
                "upstream": "JSON", "inputs": "JSON", "outputs": "JSON", "summary": "JSON",
                "warnings": "JSON", "message": "TEXT", "process": "INTEGER",
            },
        ),
        Table(
            name="meta",
            description="Facts of the project: schema number, origin, epoch, datum, CRS",
            key=("key",),
            columns={"key": "TEXT", "value": "JSON"},
        ),
    )
}  # fmt: skip
