"""Sections of project.toml, one model each. A key's description is its comment in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

HeightKind = Literal["auto", "ellipsoidal", "orthometric", "above_ground", "unknown"]


class Section(BaseModel):
    """A table of project.toml; degrees, millimetres and the like stand in the key."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class ProjectSection(Section):
    """The site as a whole."""

    name: str = Field(default="", description="Name of the site, for titles")
    crs: str = Field(
        default="auto",
        description='Map CRS of all products: "auto" (UTM), "EPSG:6549" (State Plane in feet is '
        'fine), "EPSG:6549 ground 1.0000987", or a file with WKT; docs/crs.md',
    )
    datum_output: str = Field(
        default="auto",
        description="Datum of the products as realisation and epoch, "
        'such as "NAD83(2011)@2010.0"; "auto" = that of the CRS',
    )
    grids: Path | None = Field(
        default=None,
        description="Folder of PROJ's grids (geoids, datums); else GEOREF_GRIDS, else PROJ's own",
    )
    seed: int = Field(default=0, ge=0, description="Seed of every random choice")


class PhotosSection(Section):
    """Which files are the photos."""

    folder: Path = Field(
        default=Path("photos"), description="Folder of the photos, relative to this file"
    )
    patterns: tuple[str, ...] = Field(
        default=("*.jpg", "*.jpeg", "*.tif", "*.tiff"),
        description="File names to take, in either case of letters",
    )
    exclude: tuple[str, ...] = Field(default=(), description="File names to leave out")
    subfolders: bool = Field(default=False, description="Look into subfolders too")


class CameraSection(Section):
    """Interior orientation, where the user knows better than the tags.

    A table [cameras."MODEL"] with the same keys holds for one camera only.
    """

    focal_px: float | None = Field(
        default=None, gt=0, description="Focal length, px of the photos as read"
    )
    focal_mm: float | None = Field(
        default=None, gt=0, description="Focal length, mm (with sensor_width_mm)"
    )
    sensor_width_mm: float | None = Field(default=None, gt=0, description="Width of the sensor, mm")
    model: str | None = Field(
        default=None, description='Lens model: "brown", "brown_inverse" or "fisheye"'
    )
    fx: float | None = Field(default=None, gt=0, description="Focal length along u, px")
    fy: float | None = Field(default=None, gt=0, description="Focal length along v, px")
    cx: float | None = Field(
        default=None, description="Principal point u, px; 0 = centre of first pixel"
    )
    cy: float | None = Field(default=None, description="Principal point v, px")
    k1: float | None = Field(
        default=None, description="Radial distortion, ideal to distorted (OpenCV)"
    )
    k2: float | None = Field(default=None, description="Radial distortion")
    k3: float | None = Field(default=None, description="Radial distortion")
    k4: float | None = Field(default=None, description="Radial distortion of a fisheye")
    p1: float | None = Field(default=None, description="Decentring distortion")
    p2: float | None = Field(default=None, description="Decentring distortion")
    b1: float | None = Field(default=None, description="fx - fy, px")
    b2: float | None = Field(default=None, description="Skew, px")
    resized_from: tuple[int, int] | None = Field(
        default=None, description="Width and height in px before the photos were made smaller"
    )
    cropped_from: tuple[int, int, int, int] | None = Field(
        default=None,
        description="Full width and height, then column and row of the crop's first pixel, px",
    )
    readout_s: float | None = Field(
        default=None, ge=0, description="Time to read the sensor, s; 0 for a mechanical shutter"
    )
    sigma_focal_percent: float | None = Field(
        default=None, gt=0, description="One sigma of the focal length, %"
    )
    sigma_principal_point_px: float | None = Field(
        default=None, gt=0, description="One sigma of the principal point, along u and v each, px"
    )


class MountSection(Section):
    """How the camera sits on the vehicle: vectors from the IMU, forward right down."""

    lever_arm_camera_m: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="IMU to camera, body axes, m"
    )
    lever_arm_antenna_m: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="IMU to GNSS antenna, body axes, m"
    )
    sigma_lever_arm_m: float = Field(default=0.05, gt=0, description="One sigma of a lever arm, m")
    boresight_deg: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0),
        description="Small rotation of the camera, vector in body axes, deg",
    )
    sigma_boresight_deg: float = Field(
        default=1.0, gt=0, description="One sigma of the boresight, deg"
    )
    looks: Literal["down", "forward"] = Field(
        default="down", description='Where a fixed camera looks: "down" or "forward"'
    )
    image_top: Literal["forward", "right", "back", "left"] = Field(
        default="forward", description="Where the top of the image of a camera looking down points"
    )
    gimbal: bool = Field(
        default=False, description="A gimbal turns the camera: angles come from the tags"
    )


class GnssSection(Section):
    """Positions in the tags or logs."""

    datum: str = Field(
        default="unknown",
        description='Realisation and epoch, such as "ITRF2020@2026.4"; "unknown" adds 2 m of sigma',
    )
    height_kind: HeightKind = Field(
        default="auto",
        description='"auto" (as the maker does), "ellipsoidal", "orthometric", "above_ground"',
    )
    geoid: str = Field(default="egm96", description="Geoid of orthometric heights")
    position_of: Literal["auto", "antenna", "camera"] = Field(
        default="auto", description='What a tag\'s position is of: "auto", "antenna" or "camera"'
    )
    sigma_h_m: float | None = Field(
        default=None, gt=0, description="One sigma in east and north, m; from the tags, else 2.2"
    )
    sigma_v_m: float | None = Field(
        default=None, gt=0, description="One sigma of the height, m; from the tags, else 5"
    )
    latency_s: float | None = Field(
        default=None, description="By how much the fixes of the log are stamped late, s; else found"
    )
    slow_sigma_m: float | None = Field(
        default=None, ge=0, description="Slow error of the log's fixes per axis, m; else found"
    )
    slow_tau_s: float = Field(default=100.0, gt=0, description="Correlation time of that error, s")


class AttitudeSection(Section):
    """Angles in the tags or logs."""

    dialect: str = Field(
        default="auto",
        description='Convention of the angles: "auto", or a name of the table in docs/frames.md',
    )
    yaw_source: Literal["auto", "gimbal", "flight", "course"] = Field(
        default="auto", description='"auto", "gimbal", "flight" or "course" (made good)'
    )
    sigma_roll_pitch_deg: float | None = Field(
        default=None, gt=0, description="One sigma of roll and pitch, deg; by dialect"
    )
    sigma_yaw_deg: float | None = Field(
        default=None, gt=0, description="One sigma of yaw, deg; by dialect"
    )
    rotate_photos: dict[str, Literal[0, 90, 180, 270]] = Field(
        default_factory=dict,
        description="Photos whose pixels were turned after the flight, "
        'degrees clockwise, such as {"DJI_0024.JPG" = 180}',
    )


class GroundSection(Section):
    """Where the ground is: a DEM, or one height."""

    dem: Path | None = Field(default=None, description="Raster of ground heights")
    dem_height_kind: Literal["auto", "ellipsoidal", "orthometric"] = Field(
        default="auto",
        description='Kind of the DEM\'s heights: "auto", "ellipsoidal", "orthometric"',
    )
    dem_unit: Literal["auto", "m", "ft", "us-ft"] = Field(
        default="auto",
        description='Unit of the DEM\'s heights: "auto" (as the file says), "m", "ft", "us-ft"',
    )
    height_m: float | None = Field(default=None, description="One height of the ground, m")
    height_kind: Literal["ellipsoidal", "orthometric"] = Field(
        default="orthometric", description='Kind of height_m: "ellipsoidal" or "orthometric"'
    )
    height_above_ground_m: float | None = Field(
        default=None,
        gt=0,
        description="Usual flying height above ground, m; tags tell how photos differ from it",
    )
    sigma_m: float | None = Field(
        default=None, gt=0, description="One sigma of the ground's height, m"
    )

    @field_validator("height_above_ground_m")
    @classmethod
    def _one_height(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("height_m") is not None:
            words = "is given together with height_m; give only one of the two"
            raise PydanticCustomError("two_heights", words)
        return value


class PosesSection(Section):
    """Positions and angles from a file instead of the tags."""

    file: Path | None = Field(
        default=None, description="ODM geo.txt, or reference CSV of Metashape, Pix4D"
    )
    format: Literal["auto", "odm", "metashape", "pix4d", "orthority", "opensfm", "colmap"] = Field(
        default="auto",
        description='"auto", "odm", "metashape", "pix4d", "orthority", "opensfm" or "colmap"',
    )
    crs: str | None = Field(default=None, description="CRS of the file if it does not say")


class ControlSection(Section):
    """Control and check points; formats and traps are told in docs/control.md."""

    file: Path | None = Field(
        default=None, description="Points: control.csv, gcp_list.txt, Pix4D, Metashape, DroneDeploy"
    )
    marks: Path | None = Field(
        default=None, description="Their pixels in the photos (marks.csv), if apart"
    )
    format: Literal["auto", "georef", "odm", "pix4d", "metashape", "dronedeploy"] = Field(
        default="auto",
        description='"auto" (by content), "georef", "odm", "pix4d", "metashape", "dronedeploy"',
    )
    crs: str | None = Field(default=None, description="CRS of the points if the file does not say")
    datum: str = Field(default="auto", description='Datum of the points; "auto" = as the file says')
    height_kind: Literal["auto", "ellipsoidal", "orthometric", "none"] = Field(
        default="auto",
        description='"auto" (as the file says), "ellipsoidal", "orthometric", "none" = not used',
    )
    height_unit: Literal["auto", "m", "ft", "us-ft"] = Field(
        default="auto", description='Unit of the heights: "auto" (as the file says), "m", "us-ft"'
    )
    geoid: str | None = Field(
        default=None, description="Geoid of orthometric heights if the file does not say"
    )
    pixel_zero: Literal["auto", "centre", "corner"] = Field(
        default="auto",
        description='Where (0, 0) is in the first pixel: "auto" (by format), "centre", "corner"',
    )
    sigma_h_m: float | None = Field(
        default=None, gt=0, description="One sigma in east and north, m; of the file, else 0.02"
    )
    sigma_v_m: float | None = Field(
        default=None, gt=0, description="One sigma of the heights, m; of the file, else 0.02"
    )
    sigma_px: float | None = Field(
        default=None, gt=0, description="One sigma of a mark, px; of the file, else 0.5"
    )
    control: tuple[str, ...] = Field(
        default=(), description="Names of points to adjust to, whatever the file says"
    )
    check: tuple[str, ...] = Field(
        default=(), description='Names of points to check with only, such as ["HV11"]'
    )
    off: tuple[str, ...] = Field(default=(), description="Names of points to leave out")


class LogsSection(Section):
    """Logs of the flight; formats and columns are told in docs/logs.md."""

    imu: Path | None = Field(default=None, description="IMU log")
    gnss: Path | None = Field(default=None, description="GNSS log, or PPK positions (.pos)")
    attitude: Path | None = Field(default=None, description="Attitude of an autopilot")
    sync: Path | None = Field(default=None, description="Sync-board log, or other exposure events")
    trajectory: Path | None = Field(
        default=None, description="Finished trajectory, such as an SBET, in place of the logs"
    )
    files: tuple[Path, ...] = Field(
        default=(), description="Logs that hold several of these, such as .ulg or .BIN"
    )
    columns: dict[str, Any] = Field(
        default_factory=dict,
        description='Columns that headers do not tell, such as {gyro_x = "GyroX:deg/s"}',
    )
    filter: Literal["auto", "inertial", "ekf9", "gnss"] = Field(
        default="auto",
        description='"auto", "inertial" (15 states and more), "ekf9" (the 2009 report\'s), '
        '"gnss" (no IMU)',
    )
    camera_clock_offset_s: float | None = Field(
        default=None, description="Camera clock minus UTC, s, time zone included, where known"
    )
    sigma_camera_clock_s: float = Field(
        default=30.0, gt=0, description="One sigma of camera_clock_offset_s, s"
    )
    shutter_lag_s: float = Field(
        default=0.0, description="Exposure after the noted event, s; negative = before"
    )


class ImuSection(Section):
    """Errors of the IMU as its maker states them; with `tune` the log corrects the noise."""

    gyro_noise_deg_rt_h: float = Field(
        default=0.3, gt=0, description="Angular random walk, deg per root hour"
    )
    accel_noise_m_s_rt_h: float = Field(
        default=0.1, gt=0, description="Velocity random walk, m/s per root hour"
    )
    gyro_bias_deg_h: float = Field(default=1000.0, gt=0, description="One sigma of a bias, deg/h")
    accel_bias_m_s2: float = Field(default=0.15, gt=0, description="One sigma of a bias, m/s2")
    gyro_scale_percent: float = Field(
        default=0.5, ge=0, description="One sigma of a gyro's scale, %; 0 = not estimated"
    )
    gyro_misalignment_deg: float = Field(
        default=0.3, ge=0, description="One sigma of a gyro's axis, deg; 0 = not estimated"
    )
    tune: bool = Field(default=True, description="Find the noise in the log itself")
    use: tuple[Literal["baro_height", "airspeed", "heading", "magnetic_field"], ...] = Field(
        default=(), description='Aids to use where logged, such as ["baro_height", "airspeed"]'
    )


class MetadataSection(Section):
    """What metadata files and STAC say of who made the products; what is empty is said unknown."""

    organisation: str = Field(default="", description="Who answers for the products")
    contact: str = Field(default="", description="Name of a person there, or of an office")
    email: str = Field(default="", description="Its e-mail address")
    licence: str = Field(
        default="", description='Terms of use, such as "CC-BY-4.0" (SPDX) or a sentence'
    )


class ProductsSection(Section):
    """What to make."""

    gsd_m: float | None = Field(
        default=None, gt=0, description="Ground sample distance, m; from the photos"
    )
    orthos: bool = Field(default=True, description="One orthorectified GeoTIFF per photo")
    mosaic: bool = Field(default=True, description="One seamless mosaic")
    compression: Literal["jpeg", "deflate", "zstd", "webp"] = Field(
        default="jpeg", description='"jpeg", "webp" (lossy), "deflate" or "zstd" (exact)'
    )
    band_names: tuple[str, ...] = Field(
        default=(),
        description='Names of the bands, such as ["NIR", "green", "blue"]; else by their number',
    )
    quality: int = Field(default=85, ge=1, le=100, description="Of a lossy compression, 1 to 100")
