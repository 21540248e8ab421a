"""COLMAP's cameras and text models to and from a block.

Sources: colmap.github.io `format.html` and `cameras.html`, `sensor/models.h` (order of the
parameters). Pixels count from the outer corner of the first pixel; poses are camera from world.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import InputError
from georef_gis.frames import Array, R_from_quaternion, quaternion_from_R
from georef_gis.model.camera import Camera
from georef_gis.model.interchange.block import (
    Block,
    BlockPoints,
    Shot,
    refuse_model,
    without_skew,
)
from georef_gis.model.interchange.opencv_lens import DISTORTION, camera_of, distortion_of
from georef_gis.model.pixels import corner_from_uv, uv_from_corner
from georef_gis.model.tie_points import Indices, TiePoints

PROGRAM = "COLMAP"
_OPENCV = ("fx", "fy", "cx", "cy", "k1", "k2")
# model -> its parameters in order; k4_ to k6_ are the denominator, which we have not
_MODELS: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": (*_OPENCV, "p1", "p2"),
    "FULL_OPENCV": (*_OPENCV, "p1", "p2", "k3", "k4_", "k5_", "k6_"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV_FISHEYE": (*_OPENCV, "k3", "k4"),
}
# The simplest that holds a camera is taken.
_ORDER: dict[str, tuple[str, ...]] = {
    "brown": ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"),
    "fisheye": ("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE"),
}


# -- cameras ----------------------------------------------------------------------------------


def camera_to_colmap(camera: Camera) -> tuple[str, tuple[float, ...]]:
    """Name and parameters of the simplest model that holds a camera of ours exactly.

    Raises
    ------
    InputError
        If none does.
    """
    if camera.model not in _ORDER:
        raise refuse_model(camera, PROGRAM, tuple(_ORDER))
    camera = without_skew(camera, PROGRAM)
    cx, cy = corner_from_uv([camera.cx, camera.cy])
    values = {
        "f": camera.fx, "fx": camera.fx, "fy": camera.fy, "cx": float(cx), "cy": float(cy),
        "k4_": 0.0, "k5_": 0.0, "k6_": 0.0,
        **distortion_of(camera),
    }  # fmt: skip
    if camera.model == "brown":
        values["k4"] = 0.0
    for model in _ORDER[camera.model]:
        names = _MODELS[model]
        left = any(values[name] != 0.0 for name in DISTORTION if name not in names)
        if not left and ("f" not in names or camera.fx == camera.fy):
            return model, tuple(values[name] for name in names)
    raise refuse_model(camera, PROGRAM, tuple(_ORDER))


def camera_from_colmap(
    camera_id: str, model: str, size: tuple[int, int], parameters: ArrayLike, source: str
) -> Camera:
    """A camera of COLMAP as ours.

    Raises
    ------
    InputError
        If the model is not known or holds what ours cannot.
    """
    where = f"{source}, camera {camera_id}"
    if model not in _MODELS:
        raise InputError(
            f"'{model}' is not known; use one of {', '.join(_MODELS)}", source=where, field="MODEL"
        )
    names, given = _MODELS[model], np.asarray(parameters, dtype=np.float64).tolist()
    if len(given) != len(names):
        raise InputError(
            f"{model} has {len(names)} parameters, not {len(given)}",
            source=where,
            field="PARAMS",
        )
    values = dict.fromkeys((*DISTORTION, "k4_", "k5_", "k6_"), 0.0)
    values |= dict(zip(names, given, strict=True))
    if not all(np.isfinite(v) for v in values.values()):
        raise InputError("a parameter is not finite", source=where, field="PARAMS")
    if any(values[name] != 0.0 for name in ("k4_", "k5_", "k6_")):
        raise InputError(
            "the denominator k4, k5, k6 of FULL_OPENCV is not supported; adjust as OPENCV",
            source=where,
            field="PARAMS",
        )
    fx, fy = values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0))
    if min(size) < 1 or min(fx, fy) <= 0.0:
        raise InputError(
            f"{size[0]} x {size[1]} px with a focal length of {min(fx, fy):g} px is no camera",
            source=where,
            field="PARAMS",
        )
    cx, cy = uv_from_corner([values["cx"], values["cy"]])
    return camera_of(
        camera_id,
        size,
        {**values, "fx": fx, "fy": fy, "cx": float(cx), "cy": float(cy)},
        model="fisheye" if model.endswith("FISHEYE") else "brown",
        source=f"COLMAP {model}",
    )


# -- text out ---------------------------------------------------------------------------------


def cameras_lines(block: Block) -> Iterator[str]:
    """Lines of `cameras.txt`; cameras are numbered from 1 in their order."""
    yield "# Camera list with one line of data per camera:"
    yield "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"
    yield f"# Number of cameras: {len(block.cameras)}"
    for number, camera in enumerate(block.cameras.values(), start=1):
        model, parameters = camera_to_colmap(camera)
        yield f"{number} {model} {camera.width} {camera.height} {_numbers(parameters)}"


def images_lines(block: Block) -> Iterator[str]:
    """Lines of `images.txt`; images are numbered from 1 in the order of the shots."""
    camera_number = {key: i for i, key in enumerate(block.cameras, start=1)}
    seen = _observations(block)
    count = sum(len(uv) for uv, _ in seen)
    yield "# Image list with two lines of data per image:"
    yield "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"
    yield "#   POINTS2D[] as (X, Y, POINT3D_ID)"
    mean = count / max(len(block.shots), 1)
    yield f"# Number of images: {len(block.shots)}, mean observations per image: {mean:g}"
    for number, (shot, (uv, point)) in enumerate(zip(block.shots, seen, strict=True), start=1):
        R_cam_from_world = shot.R_world_from_cam.T
        q = quaternion_from_R(R_cam_from_world)
        t = -R_cam_from_world @ shot.origin
        camera = camera_number[shot.camera_id]
        yield f"{number} {_numbers(q)} {_numbers(t)} {camera} {shot.name}"
        xy = corner_from_uv(uv).tolist()
        rows = zip(xy, point.tolist(), strict=True)
        yield " ".join(f"{x:.6f} {y:.6f} {i + 1}" for (x, y), i in rows)


def points_lines(block: Block) -> Iterator[str]:
    """Lines of `points3D.txt`; points are numbered from 1 in their order."""
    points = block.points
    yield "# 3D point list with one line of data per point:"
    yield "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"
    if points is None:
        yield "# Number of points: 0, mean track length: 0"
        return
    tracks: list[list[str]] = [[] for _ in points.p]
    for number, (_, seen) in enumerate(_observations(block), start=1):
        for index, point in enumerate(seen.tolist()):
            tracks[point].append(f"{number} {index}")
    length = sum(map(len, tracks)) / max(len(tracks), 1)
    yield f"# Number of points: {len(tracks)}, mean track length: {length:g}"
    rgb = np.full((len(tracks), 3), 128) if points.rgb is None else points.rgb
    # COLMAP's own mark of an error that is not known
    error = np.full(len(tracks), -1.0) if points.error_px is None else points.error_px
    rows = zip(points.p.tolist(), rgb.tolist(), error.tolist(), tracks, strict=True)
    for number, (p, colour, e, track) in enumerate(rows, start=1):
        yield f"{number} {_numbers(p)} {_numbers(colour)} {e:.6g} {' '.join(track)}".rstrip()


def references_lines(block: Block) -> Iterator[str]:
    """Lines of a file for `colmap model_aligner --ref_is_gps 1`: name, latitude, longitude, h."""
    if block.origin is None:
        return
    geo = block.origin.geo_from_enu(block.centres)
    for shot, (lat, lon, h) in zip(block.shots, geo, strict=True):
        yield f"{shot.name} {np.degrees(lat):.10f} {np.degrees(lon):.10f} {h:.4f}"


def _numbers(values: Iterable[float]) -> str:
    """Numbers that are read back as they are."""
    return " ".join(repr(v) if isinstance(v, int) else repr(float(v)) for v in values)


def _observations(block: Block) -> list[tuple[Array, Indices]]:
    """Pixels (ours) and points that each shot sees, in the order of the shots."""
    nothing: tuple[Array, Indices] = (np.zeros((0, 2)), np.zeros(0, dtype=np.int32))
    if block.points is None or block.points.ties is None:
        return [nothing] * len(block.shots)
    ties = block.points.ties
    number = {name: i for i, name in enumerate(ties.photo_ids)}
    order = np.argsort(ties.photo, kind="stable")
    bounds = np.searchsorted(ties.photo[order], np.arange(len(ties.photo_ids) + 1))
    out = []
    for shot in block.shots:
        i = number.get(shot.name)
        mine = order[:0] if i is None else order[bounds[i] : bounds[i + 1]]
        out.append((ties.uv[mine], ties.point[mine]))
    return out


# -- text in ----------------------------------------------------------------------------------


def block_from_colmap(
    cameras: Iterable[str], images: Iterable[str], points: Iterable[str] | None, source: str
) -> Block:
    """Block of the lines of `cameras.txt`, `images.txt` and `points3D.txt`; it has no origin.

    Raises
    ------
    InputError
        Naming file, line and what is wrong.
    """
    by_id = dict(_read_cameras(cameras, f"{source}/cameras.txt"))
    ids, shots, pixels = [], [], []
    for image_id, shot, uv in _read_images(images, f"{source}/images.txt"):
        if shot.camera_id not in by_id:
            raise InputError(
                f"camera {shot.camera_id} is not in cameras.txt",
                source=f"{source}/images.txt, image {shot.name}",
                field="CAMERA_ID",
            )
        ids.append(image_id)
        shots.append(shot)
        pixels.append(uv)
    if not shots:
        raise InputError("has no images", source=f"{source}/images.txt")
    seen = {image_id: i for i, image_id in enumerate(ids)}
    names = tuple(shot.name for shot in shots)
    found = (
        None
        if points is None
        else _read_points(points, f"{source}/points3D.txt", seen, names, pixels)
    )
    return Block(cameras=by_id, shots=tuple(shots), points=found, source=source)


def _read_cameras(lines: Iterable[str], source: str) -> Iterator[tuple[str, Camera]]:
    for n, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        where = f"{source}, line {n}"
        cells = line.split()
        if len(cells) < 5:
            raise InputError("CAMERA_ID MODEL WIDTH HEIGHT PARAMS are needed", source=where)
        size = _floats(cells[2:4], where)
        yield (
            cells[0],
            camera_from_colmap(
                cells[0], cells[1], (int(size[0]), int(size[1])), _floats(cells[4:], where), source
            ),
        )


def _read_images(lines: Iterable[str], source: str) -> Iterator[tuple[str, Shot, Array]]:
    """Image id, shot and the pixels (ours) of its second line."""
    head: tuple[int, str] | None = None
    for n, line in enumerate(lines, start=1):
        if line.startswith("#"):
            continue
        if head is None:
            head = (n, line) if line.strip() else None
            continue
        yield _image(head, (n, line), source)
        head = None
    if head is not None:
        # The line of an image that sees no points is empty, and an editor may have cut it off.
        yield _image(head, (head[0] + 1, ""), source)


def _image(head: tuple[int, str], second: tuple[int, str], source: str) -> tuple[str, Shot, Array]:
    where = f"{source}, line {head[0]}"
    cells = head[1].strip().split(maxsplit=9)
    if len(cells) < 10:
        raise InputError("ten values are needed: IMAGE_ID, pose, CAMERA_ID and NAME", source=where)
    numbers = _floats(cells[1:8], where)
    if not np.linalg.norm(numbers[:4]) > 1e-6:
        raise InputError("the quaternion is zero", source=where, field="QW")
    R_cam_from_world = R_from_quaternion(numbers[:4])
    shot = Shot(
        name=cells[9].strip(),
        camera_id=cells[8],
        origin=-R_cam_from_world.T @ numbers[4:],
        R_world_from_cam=R_cam_from_world.T,
    )
    where = f"{source}, line {second[0]}"
    tokens = second[1].split()
    if len(tokens) % 3:
        raise InputError(
            f"X Y POINT3D_ID of the pixels of {shot.name} are needed; each image has two lines, "
            "the second empty where it sees no points",
            source=where,
        )
    return cells[0], shot, uv_from_corner(_floats(tokens, where).reshape(-1, 3)[:, :2])


def _read_points(
    lines: Iterable[str],
    source: str,
    seen: Mapping[str, int],
    names: tuple[str, ...],
    pixels: Sequence[Array],
) -> BlockPoints | None:
    p: list[Array] = []
    rgb: list[Array] = []
    error: list[float] = []
    photo: list[int] = []
    point: list[int] = []
    uv: list[Array] = []
    for n, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        where = f"{source}, line {n}"
        cells = line.split()
        if len(cells) < 8 or len(cells) % 2:
            raise InputError("POINT3D_ID X Y Z R G B ERROR TRACK are needed", source=where)
        numbers = _floats(cells[1:8], where)
        track = _track(cells[8:], where, seen, pixels)
        photo += list(track)
        uv += list(track.values())
        point += [len(p)] * len(track)
        p.append(numbers[:3])
        rgb.append(numbers[3:6])
        error.append(float(numbers[6]))
    if not p:
        return None
    known = np.array(error)
    has_gap = len(set(point)) < len(p)
    ties = TiePoints(
        photo_ids=names,
        photo=np.array(photo, dtype=np.int32),
        point=np.array(point, dtype=np.int32),
        uv=np.array(uv).reshape(-1, 2),
        sigma=np.ones(len(photo)),
    ) if not has_gap else None  # fmt: skip
    return BlockPoints(
        p=np.array(p),
        rgb=np.clip(np.array(rgb), 0, 255).astype(np.uint8),
        error_px=known if np.all(known >= 0.0) else None,
        ties=ties,
    )


def _track(
    cells: Sequence[str], where: str, seen: Mapping[str, int], pixels: Sequence[Array]
) -> dict[int, Array]:
    """Pixels of a point by photo, from pairs of an image's id and the number of a pixel."""
    track: dict[int, Array] = {}
    for image_id, index in zip(cells[::2], cells[1::2], strict=True):
        i = seen.get(image_id)
        if i is None or not index.isdigit() or int(index) >= len(pixels[i]):
            raise InputError(
                f"pixel {index} of image {image_id} is not in images.txt",
                source=where,
                field="TRACK",
            )
        # A photo may see a point twice in COLMAP; the first counts.
        track.setdefault(i, pixels[i][int(index)])
    return track


def _floats(cells: Sequence[str], source: str) -> Array:
    try:
        out = np.array([float(cell) for cell in cells])
    except ValueError as error:
        raise InputError(f"{str(error)[:80]}: not a number", source=source) from error
    if not np.all(np.isfinite(out)):
        raise InputError("a number is not finite", source=source)
    return out
