"""Calibrated interior orientation that makers write into the XMP."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from georef_gis.errors import InputError
from georef_gis.ingest.sensors import (
    SIGMA_CALIBRATED,
    SIGMA_NOMINAL,
    CameraReading,
    Size,
    focal_35mm,
    kind_of_reduction,
    simple_camera,
)
from georef_gis.ingest.tags import TagValue, number, numbers, text
from georef_gis.model.camera import Camera

Reading = Mapping[str, TagValue]

# A calibrated focal length differs from the 35 mm equivalent by less, as a logarithm.
_PLAUSIBLE = 0.15
# px, one sigma of a calibrated principal point, share of the width
_SIGMA_CENTRE = 0.001
# From offsets counted from a corner of the picture to the centre of the first pixel: assumed for
# DJI, Pix4D and Skydio, whose documents do not say.
_HALF_PIXEL = 0.5


def calibrated(tags: Reading, camera_id: str, size: Size, full: Size) -> CameraReading | str | None:
    """Camera of a calibration in the tags; a note if it cannot be believed, else None.

    Raises
    ------
    InputError
        If the calibration is of a model that is not known.
    """
    notes: list[str] = []
    for reader in _READERS:
        found = reader(tags, camera_id, size, full)
        if isinstance(found, CameraReading):
            camera = replace(found.camera, notes=(*found.camera.notes, *notes))
            return replace(found, camera=camera)
        if found is not None:
            notes.append(found)
    return "; ".join(notes) or None


def _scaled(camera: Camera, size: Size, full: Size) -> Camera:
    """Camera of the picture as taken -> of the stored picture, resized or cropped in the middle."""
    width, height = size
    if kind_of_reduction(size, full) == "resized":
        sx, sy = width / full[0], height / full[1]
        # uv' = s (uv + 0.5) - 0.5
        cx, cy = sx * (camera.cx + 0.5) - 0.5, sy * (camera.cy + 0.5) - 0.5
    else:
        sx = sy = 1.0
        cx, cy = camera.cx - (full[0] - width) / 2.0, camera.cy - (full[1] - height) / 2.0
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * sx,
        fy=camera.fy * sy,
        cx=cx,
        cy=cy,
        sigma_f=camera.sigma_f * sx,
        sigma_c=camera.sigma_c * sx,
    )


def _implausible(tags: Reading, focal: float, full: Size, field: str) -> str | None:
    """Why a focal length, px of the picture as taken, cannot be believed."""
    expected = focal_35mm(tags, full, full)
    if expected is not None and abs(math.log(focal / expected)) > _PLAUSIBLE:
        return f"[{field}] {focal:.1f} px was ignored: the 35 mm equivalent gives {expected:.0f} px"
    if not 0.2 * full[0] < focal < 20.0 * full[0]:
        return f"[{field}] {focal:.1f} px was ignored: no lens for a picture {full[0]} px wide"
    return None


def _pix4d(tags: Reading, camera_id: str, size: Size, full: Size) -> CameraReading | str | None:
    """`Camera` XMP: perspective or fisheye, in mm beside the focal-plane resolution.

    Notes
    -----
    PerspectiveDistortion is R1, R2, R3, T1, T2 in OpenCV's sense (MicaSense imageprocessing,
    `cv2_distortion_coeff`: [0, 1, 3, 4, 2]).
    """
    model = text(tags, "XMP-Camera:ModelType").lower()
    focal_mm = number(tags, "XMP-Camera:PerspectiveFocalLength")
    matrix = numbers(tags, "XMP-Camera:FisheyeAffineMatrix")
    if not model and focal_mm is None and not matrix:
        return None
    per_mm = _pixels_per_mm(tags)
    centre = numbers(tags, "XMP-Camera:PrincipalPoint")
    if len(centre) == 2 and per_mm is None:
        return "[XMP-Camera:PrincipalPoint] is in mm, but there is no focal-plane resolution"
    if model in ("", "perspective"):
        camera = _pix4d_perspective(tags, camera_id, full, focal_mm, per_mm)
    elif model == "fisheye":
        camera = _pix4d_fisheye(tags, camera_id, full, matrix)
    else:
        raise InputError(
            f"camera model '{model}' is not known; use perspective or fisheye, or give [camera] fx",
            source=f"camera {camera_id}",
            field="XMP-Camera:ModelType",
        )
    if isinstance(camera, str):
        return camera
    if len(centre) == 2 and per_mm is not None:
        camera = replace(
            camera,
            cx=centre[0] * per_mm - _HALF_PIXEL,
            cy=centre[1] * per_mm - _HALF_PIXEL,
            sigma_c=_SIGMA_CENTRE * full[0],
        )
    # us; from the first to the last row. Sequoia's global-shutter bands state one as well.
    readout = number(tags, "XMP-Camera:LineReadoutTime")
    if readout and text(tags, "File:FileType") == "JPEG":
        camera = replace(camera, notes=(*camera.notes, f"LineReadoutTime {readout:g} is not used"))
    return CameraReading(camera=_scaled(camera, size, full))


def _pixels_per_mm(tags: Reading) -> float | None:
    value = number(tags, "EXIF:FocalPlaneXResolution")
    unit = int(number(tags, "EXIF:FocalPlaneResolutionUnit") or 2)
    per_mm = {2: 1.0 / 25.4, 3: 0.1, 4: 1.0, 5: 1000.0}.get(unit)
    return value * per_mm if value and per_mm else None


def _pix4d_perspective(
    tags: Reading, camera_id: str, full: Size, focal_mm: float | None, per_mm: float | None
) -> Camera | str:
    if focal_mm is None:
        return "[XMP-Camera:PerspectiveFocalLength] is missing"
    unit = text(tags, "XMP-Camera:PerspectiveFocalLengthUnits").lower() or "mm"
    if unit not in ("mm", "pixels", "pixel", "px") or (unit == "mm" and per_mm is None):
        return f"[XMP-Camera:PerspectiveFocalLength] in {unit} cannot be turned into pixels"
    focal = focal_mm * (per_mm or 0.0) if unit == "mm" else focal_mm
    problem = _implausible(tags, focal, full, "XMP-Camera:PerspectiveFocalLength")
    if problem:
        return problem
    d = numbers(tags, "XMP-Camera:PerspectiveDistortion")
    d = d if len(d) == 5 else (0.0,) * 5
    camera = simple_camera(
        camera_id, full, focal, sigma_share=SIGMA_CALIBRATED, source="Pix4D Camera XMP"
    )
    return replace(camera, k1=d[0], k2=d[1], k3=d[2], p1=d[3], p2=d[4])


def _pix4d_fisheye(
    tags: Reading, camera_id: str, full: Size, matrix: tuple[float, ...]
) -> Camera | str:
    """Affine C, D, E, F, px, and the polynomial 0, 1, p2, p3 of the angle / 90 deg.

    Notes
    -----
    Pix4D, "How are the internal camera parameters defined"; checked by C * 2/pi = FocalLength in
    pixels (Sequoia: 1064 and 1061 px).
    """
    poly = numbers(tags, "XMP-Camera:FisheyePolynomial")
    if len(matrix) != 4 or len(poly) < 3 or poly[0] != 0.0 or abs(poly[1] - 1.0) > 1e-9:
        return "[XMP-Camera:FisheyePolynomial, FisheyeAffineMatrix] are not complete"
    c, d, e, f = matrix
    if e != 0.0:
        return f"[XMP-Camera:FisheyeAffineMatrix] has a skew E = {e:g} that our model cannot hold"
    camera = simple_camera(
        camera_id, full, c, sigma_share=SIGMA_CALIBRATED, source="Pix4D Camera XMP, fisheye"
    )
    return replace(camera, model="fisheye_pix4d", fy=f, b2=d, poly=tuple(poly[2:]))


def _dji_dewarp(
    tags: Reading, camera_id: str, size: Size, full: Size
) -> CameraReading | str | None:
    """Date; fx, fy, cx, cy (from the middle, px), k1, k2, p1, p2, k3 as OpenCV.

    Notes
    -----
    DJI, "Phantom 4 RTK XMP data description". With DewarpFlag 1 the picture is corrected already.
    """
    data = text(tags, "XMP-drone-dji:DewarpData").partition(";")[2]
    values = numbers({"d": data}, "d") if data else ()
    if not data:
        return None
    if len(values) != 9:
        return f"[XMP-drone-dji:DewarpData] has {len(values)} numbers instead of 9"
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = values
    problem = _implausible(tags, fx, full, "XMP-drone-dji:DewarpData") if fx > 0 else "zero"
    if problem:
        return problem
    corrected = number(tags, "XMP-drone-dji:DewarpFlag") == 1.0
    if corrected:
        k1 = k2 = p1 = p2 = k3 = 0.0
    camera = simple_camera(
        camera_id, full, fx, sigma_share=SIGMA_CALIBRATED, source="DJI DewarpData"
    )
    camera = replace(
        camera,
        fy=fy,
        cx=camera.cx + cx,
        cy=camera.cy + cy,
        k1=k1,
        k2=k2,
        k3=k3,
        p1=p1,
        p2=p2,
        sigma_c=_SIGMA_CENTRE * full[0],
        notes=("DewarpFlag 1: the picture is corrected already",) if corrected else (),
    )
    return CameraReading(camera=_scaled(camera, size, full))


def _dji_nominal(
    tags: Reading, camera_id: str, size: Size, full: Size
) -> CameraReading | str | None:
    """CalibratedFocalLength, px; some models write micrometres (M3T: 9100 for 9.1 mm)."""
    name = "XMP-drone-dji:CalibratedFocalLength"
    focal = number(tags, name)
    if not focal or focal <= 0:
        return None
    focal_mm = number(tags, "EXIF:FocalLength")
    problem = _implausible(tags, focal, full, name)
    if problem:
        micrometres = focal_mm is not None and abs(focal - 1000.0 * focal_mm) < 1.0
        return problem + (" and it is the focal length in micrometres" if micrometres else "")
    camera = simple_camera(
        camera_id, full, focal, sigma_share=SIGMA_NOMINAL, source="DJI CalibratedFocalLength"
    )
    centre = [number(tags, f"XMP-drone-dji:CalibratedOpticalCenter{axis}") for axis in "XY"]
    if centre[0] and centre[1]:
        camera = replace(camera, cx=centre[0] - _HALF_PIXEL, cy=centre[1] - _HALF_PIXEL)
    return CameraReading(camera=_scaled(camera, size, full))


def _skydio(tags: Reading, camera_id: str, size: Size, full: Size) -> CameraReading | str | None:
    """CalibratedFocalLength and CalibratedOpticalCenter, px of the whole 4:3 sensor.

    Notes
    -----
    Its DewarpData states no model and is not applied. Infrared pictures carry the values of the
    colour camera beside it.
    """
    names = [f"XMP-drone-skydio:CalibratedFocalLength{axis}" for axis in "XY"]
    fx, fy = number(tags, names[0]), number(tags, names[1])
    if not fx or not fy:
        return None
    source = text(tags, "XMP-drone-skydio:CameraSource")
    if "INFRARED" in source.upper():
        return f"[{names[0]}] {fx:.0f} px was ignored: it is of the colour camera, not of {source}"
    problem = _implausible(tags, fx, full, names[0])
    if problem:
        return problem
    camera = simple_camera(
        camera_id, full, fx, sigma_share=SIGMA_NOMINAL, source="Skydio CalibratedFocalLength"
    )
    notes = ("Skydio's DewarpData names no model and is not applied",)
    camera = replace(camera, fy=fy, notes=notes)
    cx, cy = (number(tags, f"XMP-drone-skydio:CalibratedOpticalCenter{a}") for a in "XY")
    if cx and cy:
        # 16:9 pictures are rows from the middle of the 4:3 sensor.
        cut = max(0.0, (round(full[0] * 0.75) - full[1]) / 2.0)
        cut = cut - cut % 1.0 if abs(cy - full[1] / 2.0) > 0.1 * full[1] else 0.0
        if abs(cy - cut - full[1] / 2.0) < 0.1 * full[1]:
            camera = replace(
                camera,
                cx=cx - _HALF_PIXEL,
                cy=cy - cut - _HALF_PIXEL,
                sigma_c=_SIGMA_CENTRE * full[0],
            )
    return CameraReading(camera=_scaled(camera, size, full))


_READERS: tuple[Callable[[Reading, str, Size, Size], CameraReading | str | None], ...] = (
    _pix4d,
    _dji_dewarp,
    _dji_nominal,
    _skydio,
)
