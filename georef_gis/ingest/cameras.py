"""Interior orientation from what is known, the best source first."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from georef_gis.errors import InputError, MissingMetadataError
from georef_gis.ingest.calibrations import calibrated
from georef_gis.ingest.lens_profiles import crop_factor_camera, profile_of
from georef_gis.ingest.sensors import (
    FULL_FRAME_DIAGONAL,
    SIGMA_35MM,
    SIGMA_FOCAL_PLANE,
    CameraReading,
    Size,
    describe_resize,
    focal_35mm,
    full_size,
    reduction_sigma,
    simple_camera,
)
from georef_gis.ingest.tags import TagValue, number, text
from georef_gis.model.camera import CAMERA_MODELS, Camera

__all__ = ["CameraOverride", "CameraReading", "camera_for", "camera_id_of"]

Reading = Mapping[str, TagValue]

# pixels per millimetre by FocalPlaneResolutionUnit: inch, cm, mm, um (CIPA DC-008)
_PER_MM = {2: 1.0 / 25.4, 3: 0.1, 4: 1.0, 5: 1000.0}
# Focal lengths farther apart than this speak of different image sizes.
_CONTRADICTION = 0.2
# mm, 35 mm equivalent; wider lenses have distortions of tens of pixels
_WIDE_ANGLE = 18.0
# mm; sensors of cameras
_SENSOR_WIDTHS = (1.0, 60.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOverride:
    """What the user knows better than the tags; the keys of [camera] in project.toml."""

    focal_px: float | None = None
    focal_mm: float | None = None
    sensor_width_mm: float | None = None
    model: str | None = None
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    k1: float | None = None
    k2: float | None = None
    k3: float | None = None
    k4: float | None = None
    p1: float | None = None
    p2: float | None = None
    b1: float | None = None
    b2: float | None = None
    resized_from: Size | None = None
    # full width and height, then column and row of the crop's first pixel
    cropped_from: tuple[int, int, int, int] | None = None
    readout_s: float | None = None
    sigma_focal_percent: float | None = None
    sigma_principal_point_px: float | None = None


def camera_id_of(tags: Reading, width: int, height: int) -> str:
    """Name of the camera that took a photo: model, lens, focal length, band, size, serial."""
    make, model = text(tags, "EXIF:Make"), text(tags, "EXIF:Model") or "unknown camera"
    named = model if make.split(" ")[0].lower() in model.lower() else f"{make} {model}".strip()
    focal = number(tags, "EXIF:FocalLength")
    band = text(tags, "XMP-Camera:RigCameraIndex", "XMP-drone-dji:ImageSource")
    serial = text(tags, "EXIF:SerialNumber", "XMP-drone-dji:CameraSerialNumber")
    parts = [
        named,
        "" if focal is None else f"{focal:.4g}mm",
        f"{width}x{height}",
        f"({band})" if band else "",
        f"#{serial}" if serial else "",
    ]
    return " ".join(part for part in parts if part)


def camera_for(
    tags: Reading, size: Size, *, override: CameraOverride | None = None, source: str = ""
) -> CameraReading:
    """Interior orientation of a photo's camera.

    The order: the user's values, calibration in the XMP, lens profile, focal-plane resolution,
    35 mm equivalent, field of view.

    Parameters
    ----------
    tags
        Normalised tags.
    size : px
        Width and height of the stored image.
    override
        The user's values.
    source
        Name of the file, for messages.

    Raises
    ------
    InputError
        If a calibration is of a model that is not known.
    MissingMetadataError
        If nothing gives the focal length.
    """
    camera_id = camera_id_of(tags, *size)
    own = override or CameraOverride()
    found = _from_override(camera_id, size, own)
    if found is None:
        found = _from_tags(tags, camera_id, size, own, source)
    camera = _with_override(found.camera, own)
    return CameraReading(camera=camera, doubts=found.doubts)


def _from_tags(
    tags: Reading, camera_id: str, size: Size, own: CameraOverride, source: str
) -> CameraReading:
    full = own.resized_from or full_size(tags, size)
    stored = size
    if own.cropped_from:
        # The camera of the whole picture, of which a window is left afterwards.
        full = stored = own.cropped_from[:2]
    notes: list[str] = []
    for reader in _READERS:
        found = reader(tags, camera_id, stored, full)
        if found is None:
            continue
        if isinstance(found, str):
            notes.append(found)
            continue
        doubts = list(found.doubts)
        if own.cropped_from:
            found = replace(found, camera=_window(found.camera, size, own.cropped_from))
        camera = replace(found.camera, notes=(*found.camera.notes, *notes))
        if not own.resized_from and not own.cropped_from:
            doubts.extend(describe_resize(size, full, camera.fx))
            camera = replace(
                camera, sigma_f=math.hypot(camera.sigma_f, reduction_sigma(size, full, camera.fx))
            )
        return CameraReading(camera=camera, doubts=tuple(doubts))
    model = text(tags, "EXIF:Model") or "the camera"
    raise MissingMetadataError(
        f"no focal length in pixels can be found for {model}: no calibration, focal-plane "
        "resolution or 35 mm equivalent"
        + (f" ({'; '.join(notes)})" if notes else "")
        + "; give [camera] focal_px, or focal_mm with sensor_width_mm",
        source=source,
        field="EXIF:FocalLengthIn35mmFormat",
    )


def _from_override(camera_id: str, size: Size, own: CameraOverride) -> CameraReading | None:
    focal = own.fx or own.focal_px
    sigma = 0.005
    if focal is None and own.focal_mm is not None and own.sensor_width_mm is not None:
        # The sensor's width belongs to the whole image, not to a crop of it.
        width = own.cropped_from[0] if own.cropped_from else size[0]
        focal = own.focal_mm / own.sensor_width_mm * width
        sigma = 0.01
    if focal is None:
        return None
    full = own.cropped_from[:2] if own.cropped_from else size
    camera = simple_camera(camera_id, full, focal, sigma_share=sigma, source="project.toml")
    if own.cropped_from:
        camera = _window(camera, size, own.cropped_from)
    return CameraReading(camera=camera)


def _window(camera: Camera, size: Size, crop: tuple[int, int, int, int]) -> Camera:
    """Camera of a window of a picture: full size, then column and row of its first pixel."""
    _, _, column, row = crop
    width, height = size
    cx, cy = camera.cx - column, camera.cy - row
    return replace(camera, width=width, height=height, cx=cx, cy=cy)


def _with_override(camera: Camera, own: CameraOverride) -> Camera:
    """Camera with the user's other values put in."""
    changes: dict[str, object] = {}
    if own.model is not None:
        if own.model not in CAMERA_MODELS:
            raise InputError(
                f"camera model '{own.model}' is not known; use one of {', '.join(CAMERA_MODELS)}",
                source="project.toml",
                field="[camera] model",
            )
        changes["model"] = own.model
    focal = own.fx or own.focal_px
    if focal is not None:
        changes |= {"fx": focal, "fy": own.fy or focal}
    elif own.fy is not None:
        changes["fy"] = own.fy
    for name in ("cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2", "readout_s"):
        value = getattr(own, name)
        if value is not None:
            changes[name] = value
    if own.sigma_focal_percent is not None:
        changes["sigma_f"] = (focal or camera.fx) * own.sigma_focal_percent / 100.0
    if own.sigma_principal_point_px is not None:
        changes["sigma_c"] = own.sigma_principal_point_px
    if not changes:
        return camera
    origin = camera.source if camera.source == "project.toml" else f"project.toml, {camera.source}"
    return replace(camera, source=origin, **changes)  # type: ignore[arg-type]


def _from_focal_plane(
    tags: Reading, camera_id: str, size: Size, full: Size
) -> CameraReading | str | None:
    focal_mm = number(tags, "EXIF:FocalLength")
    x = number(tags, "EXIF:FocalPlaneXResolution")
    y = number(tags, "EXIF:FocalPlaneYResolution") or x
    if not focal_mm or not x or not y or x <= 0 or y <= 0:
        return None
    if text(tags, "EXIF:Make").upper() == "FLIR" and x < 60.0:
        # FLIR writes the size of the sensor, mm, where pixels per unit belong.
        x, y = full[0] / x, full[1] / y
    else:
        per_mm = _PER_MM.get(int(number(tags, "EXIF:FocalPlaneResolutionUnit") or 2))
        if per_mm is None:
            return "[EXIF:FocalPlaneResolutionUnit] is not known"
        x, y = x * per_mm, y * per_mm
    if not _SENSOR_WIDTHS[0] <= full[0] / x <= _SENSOR_WIDTHS[1]:
        return (
            f"[EXIF:FocalPlaneXResolution] gives a sensor of {full[0] / x:.1f} mm width, "
            "which is none"
        )
    scale = size[0] / full[0]
    fx, fy = focal_mm * x * scale, focal_mm * y * scale
    expected = focal_35mm(tags, size, full)
    if expected is not None and abs(math.log(fx / expected)) > _CONTRADICTION:
        return (
            f"[EXIF:FocalPlaneXResolution] gives {fx:.0f} px, the 35 mm equivalent "
            f"{expected:.0f} px: the picture was made smaller; the 35 mm equivalent is used"
        )
    if abs(fx / fy - 1.0) < 0.01:
        # Makers round the two axes apart; pixels are square.
        fx = fy = math.sqrt(fx * fy)
    camera = simple_camera(
        camera_id, size, fx, sigma_share=SIGMA_FOCAL_PLANE, source="focal-plane resolution"
    )
    return CameraReading(camera=replace(camera, fy=fy))


def _from_35mm(tags: Reading, camera_id: str, size: Size, full: Size) -> CameraReading | str | None:
    focal = focal_35mm(tags, size, full)
    if focal is None:
        return None
    equivalent = number(tags, "EXIF:FocalLengthIn35mmFormat") or 0.0
    # The equivalent is a whole number of millimetres.
    rounding = 0.5 / math.sqrt(3.0) / equivalent
    camera = simple_camera(
        camera_id,
        size,
        focal,
        sigma_share=math.hypot(SIGMA_35MM, rounding),
        source="35 mm equivalent",
    )
    note = f"{equivalent:g} mm on the diagonal of {FULL_FRAME_DIAGONAL:.2f} mm"
    doubts = (
        (
            f"[EXIF:FocalLengthIn35mmFormat] {equivalent:g} mm is a wide angle whose distortion is "
            "not known: positions towards the corners are off; give [camera] k1, k2 of a "
            "calibration",
        )
        if equivalent < _WIDE_ANGLE
        else ()
    )
    return CameraReading(camera=replace(camera, notes=(note,)), doubts=doubts)


def _from_field_of_view(
    tags: Reading, camera_id: str, size: Size, full: Size
) -> CameraReading | str | None:
    """Horizontal and vertical angle of a Teal/FLIR Hadron, degrees."""
    h = number(tags, "XMP-exif:CameraHorizontalFOV")
    v = number(tags, "XMP-exif:CameraVerticalFOV")
    if h is None or v is None or not (1.0 < h < 170.0 and 1.0 < v < 170.0):
        return None
    fx = size[0] / 2.0 / math.tan(math.radians(h) / 2.0)
    fy = size[1] / 2.0 / math.tan(math.radians(v) / 2.0)
    if abs(fx / fy - 1.0) > 0.05:
        return f"the fields of view {h:g} and {v:g} deg do not belong to square pixels"
    camera = simple_camera(
        camera_id, size, math.sqrt(fx * fy), sigma_share=0.01, source="field of view in the XMP"
    )
    return CameraReading(camera=camera)


_READERS: tuple[Callable[[Reading, str, Size, Size], CameraReading | str | None], ...] = (
    calibrated,
    profile_of,
    _from_focal_plane,
    _from_35mm,
    crop_factor_camera,
    _from_field_of_view,
)
