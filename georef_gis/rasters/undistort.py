"""Photos without their lens' distortion: resampled to a pinhole camera, tags kept."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.rasters import jpeg_segments as jpeg
from georef_gis.rasters import xmp_writer as xmp
from georef_gis.rasters.files import export_errors, resolve_target, whole_file
from georef_gis.rasters.jpeg_segments import Segment
from georef_gis.rasters.reading import read_image

Keep = Literal["inside", "focal", "all"]
Image = NDArray[Any]
Map = NDArray[np.float32]

# px; distance of the places at which the lens is computed, linear between them
STEP = 8
# px; a step is halved until the map is this near to the lens
TOLERANCE = 0.02
# of the plane z = 1; 80 deg off the axis, a pinhole wider than this shows a stretched rim only
WIDEST = 5.67
QUALITY = 95
# Segments that speak of the picture and not of its coding: EXIF, XMP, colour profile, comment
_KEPT_MARKS = (jpeg.EXIF_MARK, jpeg.XMP_MARK, jpeg.EXTENDED_MARK)
_ICC_MARK = b"ICC_PROFILE\0"
_APP2, _COM = 0xE2, 0xFE
# Calibrations in XMP that hold for the distorted picture only; see `ingest.calibrations`
_LENS_TAGS = frozenset(
    "ModelType PerspectiveFocalLength PerspectiveFocalLengthUnits PrincipalPoint "
    "PerspectiveDistortion FisheyePolynomial FisheyeAffineMatrix FisheyeAffineSymmetric "
    "DewarpData DewarpFlag CalibratedFocalLength CalibratedFocalLengthX CalibratedFocalLengthY "
    "CalibratedOpticalCenterX CalibratedOpticalCenterY".split()
)


def pinhole_of(camera: Camera, *, keep: Keep = "inside") -> Camera:
    """Camera without distortion for undistorted photos of the same size.

    Parameters
    ----------
    camera
        The photos' own.
    keep
        "inside": no pixel without content; "all": all content, with empty corners; "focal": the
        focal length and principal point of the camera.

    Notes
    -----
    Square pixels; the image is the largest rectangle that lies inside of the undistorted border
    ("inside"), or the smallest around it ("all").
    """
    base = replace(
        camera,
        model="brown",
        fy=camera.fx,
        k1=0.0, k2=0.0, k3=0.0, k4=0.0, p1=0.0, p2=0.0, b1=0.0, b2=0.0, poly=(),
        source=f"{camera.source}, undistorted" if camera.source else "undistorted",
        notes=(),
    )  # fmt: skip
    if keep == "focal":
        return base
    n = 64
    d = camera.ray(camera.border_uv(n))
    ahead = np.isfinite(d[:, 2]) & (d[:, 2] > 1e-3)
    xy = np.full((4 * n, 2), np.nan)
    xy[ahead] = d[ahead, :2] / d[ahead, 2:]
    if np.all(np.isnan(xy[:, 0])):
        raise InputError("sees no ray at its border; check its distortion", source=camera.id)
    xy = np.clip(xy, -WIDEST, WIDEST)
    around = np.vstack([xy, xy[:1]])
    top, right, bottom, left = (around[i * n : (i + 1) * n + 1] for i in range(4))
    inner = keep == "inside"
    low, high = (np.nanmax, np.nanmin) if inner else (np.nanmin, np.nanmax)
    x0, x1 = float(low(left[:, 0])), float(high(right[:, 0]))
    y0, y1 = float(low(top[:, 1])), float(high(bottom[:, 1]))
    if x1 <= x0 or y1 <= y0:
        raise InputError("its distorted border leaves no rectangle; use keep = all or focal",
                         source=camera.id)  # fmt: skip
    by_width, by_height = camera.width / (x1 - x0), camera.height / (y1 - y0)
    f = max(by_width, by_height) if inner else min(by_width, by_height)
    cx = (camera.width - 1) / 2.0 - f * (x0 + x1) / 2.0
    cy = (camera.height - 1) / 2.0 - f * (y0 + y1) / 2.0
    scale = f / camera.fx
    return replace(
        base, fx=f, fy=f, cx=cx, cy=cy, sigma_f=camera.sigma_f * scale,
        sigma_c=camera.sigma_c * scale,
    )  # fmt: skip


def undistort_map(camera: Camera, pinhole: Camera) -> tuple[Map, Map]:
    """Where each pixel of an undistorted photo lies in the stored one, for `cv2.remap`.

    Returns
    -------
    u, v : shape (height, width), px
        -10 where there is no content.

    Notes
    -----
    For Brown the same as `cv2.initUndistortRectifyMap`, which has no skew and no inverse model.
    """
    step = STEP
    while step > 1:
        grid = _nodes(camera, pinhole, step)
        if _map_error(camera, pinhole, grid, step) <= TOLERANCE:
            break
        step //= 2
    else:
        grid = _nodes(camera, pinhole, 1)
    height, width = pinhole.height, pinhole.width
    u = np.arange(width)
    i, s = u // step, (u % step) / step
    along = grid[:, i] * (1.0 - s)[:, None] + grid[:, i + 1] * s[:, None]
    out = np.empty((2, height, width), np.float32)
    for v in range(height):
        k, t = v // step, (v % step) / step
        row = along[k] * (1.0 - t) + along[k + 1] * t if t else along[k]
        out[:, v] = np.where(np.isfinite(row), row, -10.0).T
    return out[0], out[1]


def _nodes(camera: Camera, pinhole: Camera, step: int) -> Array:
    """Map at every `step` pixels and beyond the end; shape (rows, cols, 2)."""
    u = np.arange(0, pinhole.width + step, step)
    v = np.arange(0, pinhole.height + step, step)
    if step == 1:
        u, v = np.arange(pinhole.width + 1), np.arange(pinhole.height + 1)
    return _exact(camera, pinhole, np.stack(np.meshgrid(u, v), axis=-1).astype(float))


def _exact(camera: Camera, pinhole: Camera, uv: Array) -> Array:
    x = (uv[..., 0] - pinhole.cx) / pinhole.fx
    y = (uv[..., 1] - pinhole.cy) / pinhole.fy
    return camera.project(np.stack([x, y, np.ones_like(x)], axis=-1))


def _map_error(camera: Camera, pinhole: Camera, grid: Array, step: int) -> float:
    """Largest error of the map in the middles between nodes, px."""
    rows, cols = grid.shape[0] - 1, grid.shape[1] - 1
    u, v = np.meshgrid((np.arange(cols) + 0.5) * step, (np.arange(rows) + 0.5) * step)
    exact = _exact(camera, pinhole, np.stack([u, v], axis=-1))
    middle = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    error = np.hypot(*np.moveaxis(middle - exact, -1, 0))
    return float(np.nanmax(error, initial=0.0))


def undistort_image(image: Image, maps: tuple[Map, Map]) -> Image:
    """Image resampled by cubic interpolation; empty pixels are 0; shape (h, w, bands)."""
    out = cv2.remap(
        image, maps[0], maps[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=0
    )
    return out.reshape(*out.shape[:2], -1)


def undistort_photo(
    source: Path, target: Path, maps: tuple[Map, Map], *, quality: int = QUALITY
) -> tuple[str, ...]:
    """Undistorted copy of a photo, whole or not at all.

    A JPEG stays one with its EXIF (GPS, time, orientation), colour profile and XMP, of which only
    the lens' calibration is taken out. TIFF and PNG become files of their kind without tags.

    Returns
    -------
    What is missing in the copy, in words.

    Raises
    ------
    InputError
        If the source cannot be read, or is of another size.
    ExportError
        If the target cannot be written.
    """
    image = read_image(source)
    if image.shape[:2] != maps[0].shape:
        raise InputError(
            f"is {image.shape[1]} x {image.shape[0]} px, the camera is for {maps[0].shape[1]} x "
            f"{maps[0].shape[0]}; give the camera of this size",
            source=str(source),
        )
    target = resolve_target(target)
    if source.exists() and target.exists() and os.path.samefile(source, target):
        raise InputError("is the original, which is never written to", source=str(target))
    raw, doubts = _encoded(source, target, undistort_image(image, maps), quality)
    with export_errors(target, lambda: len(raw)), whole_file(target) as stream:
        stream.write(raw)
    return doubts


def _encoded(
    source: Path, target: Path, image: Image, quality: int
) -> tuple[bytes, tuple[str, ...]]:
    suffix = target.suffix.lower()
    if suffix not in (".jpg", ".jpeg", ".tif", ".tiff", ".png"):
        raise InputError(f"'{suffix}' is no kind of file for a photo; use .jpg, .tif or .png",
                         source=str(target))  # fmt: skip
    is_jpeg = suffix in (".jpg", ".jpeg")
    if is_jpeg and image.dtype != np.uint8:
        raise InputError(f"{image.dtype} does not fit into a JPEG; name a .tif", source=str(target))
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if is_jpeg else []
    bands = image.shape[2]
    if bands not in (1, 3, 4):
        raise InputError(f"has {bands} bands; 1, 3 or 4 can be written", source=str(source))
    if bands >= 3:
        image = cv2.cvtColor(
            image[..., :3] if is_jpeg else image,
            cv2.COLOR_RGB2BGR if bands == 3 or is_jpeg else cv2.COLOR_RGBA2BGRA,
        )
    done, data = cv2.imencode(suffix, image, options)
    if not done:
        raise InputError(f"cannot be coded as {suffix}", source=str(source))
    raw = data.tobytes()
    with source.open("rb") as file:
        if file.read(2) != b"\xff\xd8" or not is_jpeg:
            return raw, ("the copy has no EXIF and XMP tags: only those of JPEGs are carried over",)
        file.seek(0)
        segments, doubts = _kept_segments(jpeg.read_segments(file))
    return raw[:2] + b"".join(s.raw for s in segments) + _without_app0(raw), tuple(doubts)


def _without_app0(raw: bytes) -> bytes:
    """Coded JPEG behind its start mark and the JFIF segment, which EXIF takes the place of."""
    at = 2
    while raw[at : at + 2] == b"\xff\xe0":
        at += 2 + int.from_bytes(raw[at + 2 : at + 4], "big")
    return raw[at:]


def _kept_segments(old: list[Segment]) -> tuple[list[Segment], list[str]]:
    doubts: list[str] = []
    out: list[Segment] = []
    for one in old:
        if one.starts(jpeg.XMP_MARK):
            out += _without_lens(one, doubts)
        elif one.marker == _COM or (one.marker == _APP2 and one.payload.startswith(_ICC_MARK)):
            out.append(one)
        elif any(one.starts(mark) for mark in _KEPT_MARKS):
            out.append(one)
    if any(s.starts(jpeg.MPF_MARK, jpeg.APP2) for s in old):
        doubts.append("further pictures in the file (previews) are not in the copy")
    return out, doubts


def _without_lens(one: Segment, doubts: list[str]) -> list[Segment]:
    """XMP segment without calibrations of the distorted picture."""
    packet = xmp.parse_packet(one.payload[len(jpeg.XMP_MARK) :])
    if packet.root is None:
        doubts.append("an XMP packet is not XML: its tags are not in the copy")
        return []
    removed = False
    for node in list(packet.root.iter("{*}*")):
        for key in [str(k) for k in node.attrib if str(k).rpartition("}")[2] in _LENS_TAGS]:
            del node.attrib[key]
            removed = True
        parent = node.getparent()
        if str(node.tag).rpartition("}")[2] in _LENS_TAGS and parent is not None:
            parent.remove(node)
            removed = True
    if not removed:
        return [one]
    return [jpeg.segment(jpeg.APP1, jpeg.XMP_MARK + xmp.packet_bytes(packet))]


# -- the overlay --------------------------------------------------------------------------------


def overlay(image: Image, camera: Camera, pinhole: Camera, *, width: int = 1600) -> Image:
    """Picture of a photo before and after: red = before, cyan = after, grid lines, displacements.

    Parameters
    ----------
    image : shape (h, w, bands)
        The photo as stored.
    camera, pinhole
        Of the photo, and of the undistorted one.
    width
        Of the picture, px.

    Returns
    -------
    uint8, shape (rows, width, 3), RGB, a legend above. Yellow lines are straight in the new photo,
    orange ones the same lines in the stored photo; arrows run from there to their ideal place.
    """
    scale = min(1.0, width / camera.width)
    size = (max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
    grey = _grey(image)
    before = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    maps = undistort_map(camera, pinhole)
    after = cv2.resize(
        undistort_image(grey[..., None], maps)[..., 0], size, interpolation=cv2.INTER_AREA
    )
    out = np.stack([before, after, after], axis=-1)
    ratio = np.array(size) / [camera.width, camera.height]
    _draw_lines(out, camera, pinhole, ratio)
    largest = _draw_arrows(out, camera, pinhole, ratio)
    return np.vstack([_legend(out.shape[1], largest), out])


def _grey(image: Image) -> NDArray[np.uint8]:
    """Photo as 8 bits of grey, stretched to its 1st and 99th percentile."""
    grey = image[..., :3].mean(axis=-1) if image.ndim == 3 else image.astype(float)
    low, high = np.percentile(grey[::8, ::8], [1, 99])
    stretched = (grey - low) * (235.0 / max(float(high - low), 1e-9)) + 10
    return np.asarray(np.clip(stretched, 0, 255).astype(np.uint8))


def _lines(pinhole: Camera) -> list[Array]:
    """Straight lines over the undistorted image, every eighth of its width; px."""
    side = pinhole.width / 8.0
    along = np.linspace(0.0, 1.0, 80)[:, None]
    out = []
    for u in np.arange(side / 2, pinhole.width, side):
        out.append(np.array([u, 0.0]) + along * [0.0, pinhole.height - 1.0])
    for v in np.arange(side / 2, pinhole.height, side):
        out.append(np.array([0.0, v]) + along * [pinhole.width - 1.0, 0.0])
    return out


def _draw_lines(out: Image, camera: Camera, pinhole: Camera, ratio: Array) -> None:
    for line in _lines(pinhole):
        for points, colour in ((_exact(camera, pinhole, line), (255, 140, 0)),
                               (line, (255, 255, 0))):  # fmt: skip
            good = points[np.all(np.isfinite(points), axis=1)] * ratio
            if len(good) > 1:
                at = np.round(good * 16).astype(np.int32).reshape(-1, 1, 2)
                cv2.polylines(out, [at], False, colour, 1, cv2.LINE_AA, 4)


def _draw_arrows(out: Image, camera: Camera, pinhole: Camera, ratio: Array) -> float:
    """Arrows from stored to ideal places; returns the longest displacement, px."""
    u = np.linspace(0.02, 0.98, 17) * (pinhole.width - 1)
    v = np.linspace(0.02, 0.98, 13) * (pinhole.height - 1)
    to = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    start = _exact(camera, pinhole, to)
    inside = np.all((start >= -0.5) & (start < [camera.width - 0.5, camera.height - 0.5]), axis=1)
    length = np.hypot(*(to - start).T)
    for a, b in zip(start[inside] * ratio, to[inside] * ratio, strict=True):
        ends = [tuple(int(x) for x in np.round(p * 16)) for p in (a, b)]
        cv2.arrowedLine(out, ends[0], ends[1], (60, 255, 60), 1, cv2.LINE_AA, 4, 0.25)
    return float(length[inside].max(initial=0.0))


def _legend(width: int, largest: float) -> Image:
    lines = (
        "red: before   cyan: after   green: displacement (true to scale), "
        f"up to {largest:.1f} px of the photo",
        "orange: lines in the stored photo   yellow: the same lines undistorted (straight)",
    )
    size = width / 1600.0 * 0.7
    height = int(30 * size / 0.7)
    out = np.zeros((2 * height + 8, width, 3), np.uint8)
    for i, line in enumerate(lines):
        place = (8, height * (i + 1) - 4)
        cv2.putText(out, line, place, cv2.FONT_HERSHEY_SIMPLEX, size, (255, 255, 255), 1,
                    cv2.LINE_AA)  # fmt: skip
    return out
