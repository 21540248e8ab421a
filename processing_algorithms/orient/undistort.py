"""Tool `undistort`: photos without the distortion of their lens, and a picture of both."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.model.camera import Camera


class UndistortParameters(p.Parameters):
    """Parameters of `undistort`."""

    photos: p.Folder = p.folder(title="Folder of the photos", positional=True)
    camera: p.File = p.file(
        title="Camera: the .toml or .json of calibrate-camera, or a project.toml",
        suffixes=(".toml", ".json"),
    )
    target: p.Folder = p.folder(title="Folder for the copies", writes=True)
    keep: Literal["inside", "focal", "all"] = p.choice(
        "inside",
        title="What the new image holds",
        help='"inside": no empty corners; "focal": the same focal length; "all": every pixel',
    )
    quality: p.Integer = p.integer(95, title="Quality of JPEGs", ge=50, le=100, advanced=True)


class Undistort(Algorithm[UndistortParameters]):
    """Undistorted copies of photos, their tags kept, for programs that know pinholes only.

    The new camera is written beside them as camera.toml and camera.json, with overlay.png: before
    in red, after in cyan, lines and displacements.
    """

    id, name, group = "undistort", "Undistort photos", "orient"
    needs_project = False
    outputs = (
        Output(name="folder", title="Undistorted photos", type="Folder"),
        Output(name="section", title="Their camera for project.toml"),
        Output(name="overlay", title="Picture of before and after"),
    )

    def run(self, context: Context, parameters: UndistortParameters, feedback: Feedback) -> Result:
        """Copy."""
        import json

        from georef_gis.errors import ExportError, InputError
        from georef_gis.rasters.reading import read_image
        from georef_gis.rasters.undistort import overlay, pinhole_of, undistort_map, undistort_photo
        from georef_gis.toolbox.context import check_cancelled
        from processing_algorithms.orient.calibrate_camera import photos_in, write_whole

        paths = photos_in(parameters.photos)
        if parameters.target.exists() and parameters.target.samefile(parameters.photos):
            raise InputError("holds the originals; name another folder",
                             source=str(parameters.target), field="target")  # fmt: skip
        first = read_image(paths[0])
        camera = read_camera(parameters.camera, (first.shape[1], first.shape[0]))
        pinhole = pinhole_of(camera, keep=parameters.keep)
        maps = undistort_map(camera, pinhole)
        try:
            parameters.target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ExportError(f"{parameters.target}: cannot be made ({error.strerror})") from error
        doubts: list[str] = []
        done = 0
        for i, path in enumerate(paths):
            check_cancelled(feedback)
            try:
                told = undistort_photo(
                    path, parameters.target / path.name, maps, quality=parameters.quality
                )
                doubts += [f"{path.name}: {one}" for one in told]
                done += 1
            except InputError as error:
                doubts.append(f"left out: {error}")
            feedback.progress(0.95 * (i + 1) / len(paths), path.name)
        if not done:
            raise InputError(doubts[0])
        for doubt in doubts:
            feedback.warn(doubt)
        section, picture = parameters.target / "camera.toml", parameters.target / "overlay.png"
        write_whole(section, _section(pinhole).encode())
        account = json.dumps(camera_account(pinhole), indent=2) + "\n"
        write_whole(section.with_suffix(".json"), account.encode())
        write_whole(picture, _png(overlay(first, camera, pinhole)))
        return Result(
            outputs={"folder": parameters.target, "section": section, "overlay": picture},
            summary={"photos": done, "fx_px": round(pinhole.fx, 3), "doubts": doubts},
        )


def read_camera(path: Path, size: tuple[int, int]) -> Camera:
    """Camera of a file of `calibrate_camera`, or of [camera] in a project.toml.

    Raises
    ------
    InputError
        If it cannot be read, or states another size of photos.
    """
    import json
    import tomllib

    from georef_gis.errors import InputError
    from georef_gis.ingest.cameras import CameraOverride, camera_for

    try:
        text = path.read_text("utf-8")
        told = json.loads(text) if path.suffix.lower() == ".json" else tomllib.loads(text)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    except ValueError as error:
        raise InputError(f"is not {path.suffix[1:].upper()}: {error}", source=str(path)) from error
    if path.suffix.lower() == ".json":
        own = (told.get("width"), told.get("height"))
        if None in own:
            raise InputError(
                "is no camera; give the .json that calibrate-camera wrote", source=str(path)
            )
        if own != size:
            raise InputError(
                f"the camera is for {own[0]} x {own[1]} px, the photos have {size[0]} x {size[1]}",
                source=str(path),
                field="width",
            )
        values = {**told.get("parameters", {}), "model": told.get("model")}
    else:
        values = told.get("camera") or next(iter(told.get("cameras", {}).values()), {})
    if not values.get("fx"):
        raise InputError(
            "states no camera with fx; give the file that calibrate-camera wrote",
            source=str(path),
            field="fx",
        )
    fields = CameraOverride.__dataclass_fields__
    known: dict[str, Any] = {key: value for key, value in values.items() if key in fields}
    return camera_for({}, size, override=CameraOverride(**known), source=str(path)).camera


def camera_account(camera: Camera) -> dict[str, Any]:
    """JSON-able camera; px."""
    from georef_gis.model.camera import PARAMETERS

    return {
        "kind": "camera",
        "camera": camera.id,
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "pixel_origin": "centre of the first pixel",
        "parameters": {name: getattr(camera, name) for name in PARAMETERS},
        "source": camera.source,
    }


def _section(camera: Camera) -> str:
    lines = [
        f"# photos of {camera.width} x {camera.height} px without distortion",
        "[camera]",
        'model = "brown"',
    ]
    lines += [f"{name} = {getattr(camera, name):.4f}" for name in ("fx", "fy", "cx", "cy")]
    # Tags of the originals must not bring their distortion back.
    lines += [f"{name} = 0.0" for name in ("k1", "k2", "k3", "p1", "p2", "b1", "b2")]
    return "\n".join(lines) + "\n"


def _png(image: Any) -> bytes:
    import cv2

    from georef_gis.errors import ExportError

    done, data = cv2.imencode(".png", image[..., ::-1])
    if not done:
        raise ExportError("overlay.png: the picture cannot be coded")
    return bytes(data.tobytes())
