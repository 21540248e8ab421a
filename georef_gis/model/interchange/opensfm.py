"""OpenSfM's `reconstruction.json`, also OpenDroneMap's, to and from a block.

Sources: OpenSfM `opensfm/io.py` (keys), `opensfm/geo.py` (the world is the topocentric frame of
`reference_lla`, by way of ecef), `geometry/camera_functions.h` (projections),
`opensfm/features.py` (pixels).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import exp_so3, log_so3
from georef_gis.geodesy import HeightKind
from georef_gis.model.camera import Camera
from georef_gis.model.interchange.block import (
    OWN_KEY,
    Block,
    BlockPoints,
    Shot,
    lla_of,
    origin_of,
    own_facts,
    refuse_model,
    with_own_facts,
    without_skew,
)
from georef_gis.model.interchange.opencv_lens import DISTORTION, camera_of, distortion_of
from georef_gis.model.pixels import opensfm_from_uv, uv_from_opensfm

PROGRAM = "OpenSfM"
# projection -> parameters, all others being zero; those with one focal length look at the middle
_PROJECTIONS: dict[str, tuple[str, ...]] = {
    "perspective": ("focal", "k1", "k2"),
    "simple_radial": ("focal_x", "focal_y", "c_x", "c_y", "k1"),
    "radial": ("focal_x", "focal_y", "c_x", "c_y", "k1", "k2"),
    "brown": ("focal_x", "focal_y", "c_x", "c_y", "k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("focal", "k1", "k2"),
    "fisheye_opencv": ("focal_x", "focal_y", "c_x", "c_y", "k1", "k2", "k3", "k4"),
}
_DEFAULT_ZERO = (*DISTORTION, "c_x", "c_y")


# -- cameras ----------------------------------------------------------------------------------


def camera_to_opensfm(camera: Camera) -> dict[str, Any]:
    """A camera of ours as OpenSfM's, exactly but for a skew below `TOLERANCE_PX`.

    Raises
    ------
    InputError
        If OpenSfM has nothing like it.
    """
    if camera.model not in ("brown", "fisheye"):
        raise refuse_model(camera, PROGRAM, ("brown", "fisheye"))
    camera = without_skew(camera, PROGRAM)
    size = max(camera.width, camera.height)
    c_x, c_y = opensfm_from_uv([camera.cx, camera.cy], width=camera.width, height=camera.height)
    values = {
        "focal": camera.fx / size, "focal_x": camera.fx / size, "focal_y": camera.fy / size,
        "c_x": float(c_x), "c_y": float(c_y),
        **distortion_of(camera),
    }  # fmt: skip
    plain = camera.fx == camera.fy and c_x == c_y == 0.0
    if camera.model == "fisheye":
        kind = "fisheye" if plain and camera.k3 == camera.k4 == 0.0 else "fisheye_opencv"
    else:
        plain = plain and camera.k3 == camera.p1 == camera.p2 == 0.0
        kind = "perspective" if plain else "brown"
    return {
        "projection_type": kind,
        "width": camera.width,
        "height": camera.height,
        **{name: values[name] for name in _PROJECTIONS[kind]},
    }


def camera_from_opensfm(camera_id: str, given: Mapping[str, Any], source: str) -> Camera:
    """A camera of OpenSfM as ours.

    Raises
    ------
    InputError
        If its projection is not known or a number is missing.
    """
    where = f"{source}, camera {camera_id}"
    kind = given.get("projection_type", "perspective")
    if kind not in _PROJECTIONS:
        raise InputError(
            f"'{kind}' is not known; calibrate as one of {', '.join(_PROJECTIONS)}",
            source=where,
            field="projection_type",
        )
    values = dict.fromkeys(_DEFAULT_ZERO, 0.0)
    for name in _PROJECTIONS[kind]:
        if name in _DEFAULT_ZERO:
            values[name] = _number(given.get(name, 0.0), where, name)
        else:
            values[name] = _number(given.get(name), where, name)
    width = int(_number(given.get("width"), where, "width"))
    height = int(_number(given.get("height"), where, "height"))
    if min(width, height) < 1:
        raise InputError(f"{width} x {height} px is no size", source=where, field="width")
    size = max(width, height)
    fx = values.get("focal_x", values.get("focal", 0.0)) * size
    fy = values.get("focal_y", values.get("focal", 0.0)) * size
    if min(fx, fy) <= 0.0:
        raise InputError(f"{fx:g} px is no focal length", source=where, field="focal")
    cx, cy = uv_from_opensfm([values["c_x"], values["c_y"]], width=width, height=height)
    return camera_of(
        camera_id,
        (width, height),
        {**values, "fx": fx, "fy": fy, "cx": float(cx), "cy": float(cy)},
        model="fisheye" if kind.startswith("fisheye") else "brown",
        source=f"OpenSfM {kind}",
    )


def _number(value: Any, source: str, field: str) -> float:
    try:
        out = float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"'{value}' is not a number", source=source, field=field) from error
    if not np.isfinite(out):
        raise InputError(f"'{value}' is not a finite number", source=source, field=field)
    return out


def _vector(value: Any, source: str, field: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    if not isinstance(value, list) or len(value) != 3:
        raise InputError("three numbers are needed", source=source, field=field)
    return np.array([_number(v, source, field) for v in value])


# -- reconstructions --------------------------------------------------------------------------


def block_to_opensfm(block: Block) -> list[dict[str, Any]]:
    """What `reconstruction.json` holds: one reconstruction, in the frame of `reference_lla`.

    Raises
    ------
    InputError
        If the block has no place on the Earth, or a camera no equal.
    """
    facts = own_facts(block)
    shots = {}
    for shot in block.shots:
        rotation = log_so3(shot.R_world_from_cam.T)
        shots[shot.name] = {
            "rotation": rotation.tolist(),
            "translation": (-shot.R_world_from_cam.T @ shot.origin).tolist(),
            "camera": shot.camera_id,
            "orientation": 1,
            "capture_time": 0.0 if shot.time_unix is None else shot.time_unix,
            "gps_position": shot.origin.tolist(),
            "gps_dop": _dop(shot),
            "scale": 1.0,
        }
    origin = block.origin
    return [
        {
            "cameras": {key: camera_to_opensfm(camera) for key, camera in block.cameras.items()},
            "shots": shots,
            "points": dict(_points(block.points)),
            "biases": {},
            "reference_lla": {} if origin is None else lla_of(origin),
            OWN_KEY: facts,
        }
    ]


def _dop(shot: Shot) -> float:
    """What OpenSfM takes for the sigma of a position, m; its own default where not known."""
    if shot.covariance is None:
        return 15.0
    return float(np.sqrt(np.trace(shot.covariance[:3, :3]) / 3.0))


def _points(points: BlockPoints | None) -> Iterator[tuple[str, dict[str, Any]]]:
    if points is None:
        return
    rgb = np.full((len(points.p), 3), 128.0) if points.rgb is None else points.rgb.astype(float)
    for i, (p, colour) in enumerate(zip(points.p.tolist(), rgb.tolist(), strict=True)):
        yield str(i), {"coordinates": p, "color": colour}


def tracks_lines(block: Block) -> Iterator[str]:
    """Lines of `tracks.csv`, version 2: the observations of a block's points.

    Notes
    -----
    OpenSfM `map/src/tracks_manager.cc`: shot, track, feature, x, y, scale, r, g, b, segmentation,
    instance; separated by tabs, x and y normalised.
    """
    yield "OPENSFM_TRACKS_VERSION_v2"
    points = block.points
    if points is None or points.ties is None:
        return
    ties = points.ties
    cameras = {shot.name: block.cameras[shot.camera_id] for shot in block.shots}
    features: dict[int, int] = {}
    for photo, point, uv in zip(ties.photo, ties.point, ties.uv, strict=True):
        name = ties.photo_ids[photo]
        camera = cameras[name]
        x, y = opensfm_from_uv(uv, width=camera.width, height=camera.height)
        feature = features[int(photo)] = features.get(int(photo), -1) + 1
        r, g, b = (128, 128, 128) if points.rgb is None else (int(c) for c in points.rgb[point])
        scale = 1.0 / max(camera.width, camera.height)
        yield f"{name}\t{point}\t{feature}\t{x:.9g}\t{y:.9g}\t{scale:.6g}\t{r}\t{g}\t{b}\t-1\t-1"


def blocks_from_opensfm(data: Any, source: str, *, reference: Any = None) -> tuple[Block, ...]:
    """Blocks of what `reconstruction.json` holds, one per reconstruction, the largest first.

    Parameters
    ----------
    data
        As `json` reads it.
    reference
        What `reference_lla.json` beside it holds, for files that lack it.

    Raises
    ------
    InputError
        Naming what cannot be read.
    """
    if not isinstance(data, list) or not all(isinstance(one, dict) for one in data):
        raise InputError("is no reconstruction.json: a list of reconstructions", source=source)
    found = [_block(one, source, reference) for one in data]
    found = [block for block in found if block.shots]
    if not found:
        raise InputError("has no shots", source=source)
    return tuple(sorted(found, key=lambda block: -len(block.shots)))


def _block(one: Mapping[str, Any], source: str, reference: Any) -> Block:
    cameras = {
        str(key): camera_from_opensfm(str(key), value, source)
        for key, value in _table(one, "cameras", source)
        if isinstance(value, dict) and _is_used(str(key), one)
    }
    shots = tuple(_shot(str(name), shot, source) for name, shot in _table(one, "shots", source))
    for shot in shots:
        if shot.camera_id not in cameras:
            raise InputError(
                f"camera '{shot.camera_id}' is not among the cameras",
                source=f"{source}, shot {shot.name}",
                field="camera",
            )
    lla = one.get("reference_lla") or reference
    block = Block(
        cameras=cameras,
        shots=shots,
        # Without GPS OpenSfM writes zeros, for a frame that lies nowhere.
        origin=origin_of(lla, source) if lla and _is_somewhere(lla) else None,
        height_kind=HeightKind.UNKNOWN,
        points=_points_of(one, source),
        source=source,
    )
    return with_own_facts(block, one[OWN_KEY], source) if OWN_KEY in one else block


def _is_used(camera_id: str, one: Mapping[str, Any]) -> bool:
    """Whether a shot is of a camera: others may be of projections that are not known."""
    shots: Iterable[Any] = one.get("shots", {}).values()
    return any(isinstance(shot, dict) and shot.get("camera") == camera_id for shot in shots)


def _is_somewhere(lla: Any) -> bool:
    if not isinstance(lla, Mapping):
        return True
    return any(lla.get(key) not in (0, 0.0) for key in ("latitude", "longitude", "altitude"))


def _table(one: Mapping[str, Any], key: str, source: str) -> Iterable[tuple[Any, Any]]:
    table = one.get(key, {})
    if not isinstance(table, dict):
        raise InputError("is no table", source=source, field=key)
    return table.items()


def _shot(name: str, given: Any, source: str) -> Shot:
    where = f"{source}, shot {name}"
    if not isinstance(given, dict):
        raise InputError("is no table", source=where)
    R_cam_from_world = exp_so3(_vector(given.get("rotation"), where, "rotation"))
    t = _vector(given.get("translation"), where, "translation")
    time = given.get("capture_time")
    return Shot(
        name=name,
        camera_id=str(given.get("camera")),
        origin=-R_cam_from_world.T @ t,
        R_world_from_cam=R_cam_from_world.T,
        time_unix=float(time) if isinstance(time, int | float) and time > 0 else None,
    )


def _points_of(one: Mapping[str, Any], source: str) -> BlockPoints | None:
    table = list(_table(one, "points", source))
    if not table:
        return None
    read: Callable[[Any, str], list[float]] = lambda p, key: [float(v) for v in p[key]]  # noqa: E731
    try:
        p = np.array([read(value, "coordinates") for _, value in table]).reshape(len(table), 3)
        rgb = np.array([read(value, "color") for _, value in table]).reshape(len(table), 3)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"cannot be read ({error})", source=source, field="points") from error
    return BlockPoints(p=p, rgb=np.clip(np.rint(rgb), 0, 255).astype(np.uint8))
