"""Sizes: of the sensor, of the picture as taken, of the picture as stored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from georef_gis.ingest.tags import TagValue, number
from georef_gis.model.camera import Camera

Reading = Mapping[str, TagValue]
Size = tuple[int, int]
Reduction = Literal["none", "resized", "cropped"]

# mm; of the 36 x 24 mm frame
FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)
# share of the focal length, one sigma
SIGMA_35MM = 0.02
SIGMA_FOCAL_PLANE = 0.005
SIGMA_NOMINAL = 0.005
SIGMA_CALIBRATED = 0.001
# share of the image width, one sigma of a principal point that nobody measured
_SIGMA_CENTRE = 0.01
_SAME_ASPECT = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraReading:
    """A camera and the doubts about it."""

    camera: Camera
    doubts: tuple[str, ...] = ()


def simple_camera(
    camera_id: str,
    size: Size,
    focal: float,
    *,
    sigma_share: float,
    source: str,
    sigma_c_share: float = _SIGMA_CENTRE,
) -> Camera:
    """Camera without distortion, its principal point in the middle."""
    width, height = size
    return Camera(
        id=camera_id,
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=(width - 1) / 2.0,
        cy=(height - 1) / 2.0,
        sigma_f=sigma_share * focal,
        sigma_c=sigma_c_share * width,
        source=source,
    )


def full_size(tags: Reading, size: Size) -> Size:
    """Size of the picture as the camera took it, px; the stored size if nothing else is known."""
    stated = (number(tags, "EXIF:ExifImageWidth"), number(tags, "EXIF:ExifImageHeight"))
    if not stated[0] or not stated[1]:
        return size
    full = (int(stated[0]), int(stated[1]))
    if (full[0] - full[1]) * (size[0] - size[1]) < 0:
        # Some firmware swaps the two (DJI FC350).
        full = full[::-1]
    # A picture is never larger than it was taken; such a tag is of something else.
    return full if full[0] >= size[0] and full[1] >= size[1] else size


def kind_of_reduction(size: Size, full: Size) -> Reduction:
    """Whether a stored picture is smaller than it was taken, and how.

    Notes
    -----
    Equal aspect speaks for resizing: who crops, seldom keeps it to a percent.
    """
    if size == full:
        return "none"
    return "resized" if _same_aspect(size, full) else "cropped"


def _same_aspect(a: Size, b: Size) -> bool:
    return abs(math.log(a[0] * b[1] / (a[1] * b[0]))) < _SAME_ASPECT


def describe_resize(size: Size, full: Size, focal: float) -> list[str]:
    """Doubt about a picture whose size is not that in its EXIF, in plain words."""
    kind = kind_of_reduction(size, full)
    if kind == "none":
        return []
    what = (
        f"the photos are {size[0]} x {size[1]} px, [EXIF:ExifImageWidth, ExifImageHeight] say "
        f"{full[0]} x {full[1]} px"
    )
    if kind == "cropped":
        return [
            f"{what}: other proportions, so taken as cropped about the middle, focal length "
            f"{focal:.0f} px; if not, set [camera] cropped_from or focal_px"
        ]
    as_crop = focal * full[0] / size[0]
    return [
        f"{what}: same proportions, so taken as resized, focal length {focal:.0f} px; if they are "
        f"cropped it is {as_crop:.0f} px, so set [camera] focal_px = {as_crop:.0f}"
    ]


def reduction_sigma(size: Size, full: Size, focal: float) -> float:
    """One sigma, px, of a focal length for the chance that a resized picture is a crop.

    Notes
    -----
    A choice that is wrong one time in five has a standard deviation of 0.4 of the difference. A
    picture of less than half the size is no crop that anybody would fly with.
    """
    if kind_of_reduction(size, full) != "resized" or size[0] < full[0] / 2:
        return 0.0
    return 0.4 * focal * (full[0] / size[0] - 1.0)


def native_frame(full: Size, crop_factor: float | None) -> tuple[float, float]:
    """Width and height, px, of the whole sensor around a picture as taken.

    The 35 mm equivalent belongs to the whole sensor's diagonal, but 16:9 pictures are cut from it,
    and so are 4:3 pictures of a 1-inch sensor (3:2).

    Notes
    -----
    Sensors of crop factor above 3 and Four Thirds (1.85-2.15) are 4:3, the rest 3:2. Checked:
    FC300S 4000 x 2250 (pitch 1.56 um), FC6310 4864 x 3648 (focal length 3650 px).
    """
    width, height = float(full[0]), float(full[1])
    long, short = max(width, height), min(width, height)
    aspect = long / short
    if aspect > 1.6:
        four_thirds = crop_factor is None or crop_factor > 3.0 or 1.85 < crop_factor < 2.15
        short = long / (4.0 / 3.0 if four_thirds else 1.5)
    elif crop_factor is not None and 2.5 < crop_factor < 3.0 and aspect < 1.45:
        long = short * 1.5
    return (long, short) if width >= height else (short, long)


def taken_scale(size: Size, full: Size) -> float:
    """Stored pixels per pixel as taken: 1 unless the picture was resized."""
    return size[0] / full[0] if kind_of_reduction(size, full) == "resized" else 1.0


def focal_35mm(tags: Reading, size: Size, full: Size) -> float | None:
    """Focal length, px of the stored picture, by the 35 mm equivalent; None if there is none."""
    equivalent = number(tags, "EXIF:FocalLengthIn35mmFormat")
    if not equivalent or equivalent < 3.0:
        return None
    focal_mm = number(tags, "EXIF:FocalLength")
    factor = equivalent / focal_mm if focal_mm and focal_mm > 0 else None
    frame = native_frame(full, factor)
    return equivalent / FULL_FRAME_DIAGONAL * math.hypot(*frame) * taken_scale(size, full)
