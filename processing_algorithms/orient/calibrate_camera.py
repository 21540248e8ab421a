"""Tool `calibrate_camera`: a camera's interior orientation from photos of a board or a field."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.orient.calibration.bundle import Targets, View
    from georef_gis.orient.calibration.field import CalibrationSettings
    from georef_gis.orient.calibration.judgement import Calibration

# px, one sigma of a mark that states none: a careful click
MARK_SIGMA = 0.4
SUFFIXES = (".jpg", ".jpeg", ".tif", ".tiff", ".png")


class CalibrateCameraParameters(p.Parameters):
    """Parameters of `calibrate_camera`."""

    photos: p.Folder = p.folder(title="Folder of the photos", positional=True)
    target: p.File = p.file(
        title="File for the section of project.toml; a .json with the covariance comes beside it",
        suffixes=(".toml",),
        writes=True,
    )
    shows: Literal["chessboard", "charuco", "field"] = p.choice(
        "chessboard", title="What the photos show"
    )
    across: p.Integer = p.integer(10, title="Squares of the board, across", ge=4, le=200)
    down: p.Integer = p.integer(7, title="Squares of the board, down", ge=4, le=200)
    square: p.Length = p.length(30.0, title="Side of a square", unit="mm", gt=0, le=2000)
    marker: p.Length = p.length(
        0.0, title="Side of a marker of a ChArUco board", unit="mm", ge=0, le=2000
    )
    dictionary: p.Text = p.text(
        "DICT_4X4_50", title="Dictionary of its markers, as OpenCV names it", advanced=True
    )
    legacy: p.Flag = p.flag(
        title="The ChArUco board is of a pattern of OpenCV before 4.6", advanced=True
    )
    board_sigma: p.Length = p.length(
        0.0, title="One sigma of a corner's place on the board", unit="mm", ge=0, le=50,
        help="0 takes the board as exact; 0.2 mm lets a printed board be a little bent",
        advanced=True,
    )  # fmt: skip
    targets: p.File | None = p.file(
        None, title="Targets of a field: CSV with name, x, y, z and maybe sigma, m",
        suffixes=(".csv",),
    )  # fmt: skip
    marks: p.File | None = p.file(
        None, title="Their marks: CSV with name, photo, u, v, sigma_px", suffixes=(".csv",)
    )
    lens: Literal["brown", "fisheye"] = p.choice("brown", title="Model of the lens")
    skew: p.Flag = p.flag(title="Estimate the skew b2 too", advanced=True)
    camera: p.Text = p.text(
        "", title='Name of the camera, for [cameras."NAME"]; empty writes [camera]'
    )


class CalibrateCamera(Algorithm[CalibrateCameraParameters]):
    """Calibrate a camera on a chessboard, a ChArUco board or a field of surveyed targets.

    Writes the section [camera] for project.toml, to be pasted there, and a JSON with the full
    covariance, the rms of every photo and what is doubtful: photos left out, parts of the image
    without marks, a focal length that the photos do not fix. Take 12 or more photos with the zoom
    and focus of the flight, the board filling the image, tilted to each side and turned by 90 deg.
    """

    id, name, group = "calibrate_camera", "Calibrate a camera", "orient"
    needs_project = False
    outputs = (
        Output(name="section", title="Section for project.toml"),
        Output(name="account", title="Calibration with covariance as JSON"),
    )

    def run(
        self, context: Context, parameters: CalibrateCameraParameters, feedback: Feedback
    ) -> Result:
        """Find marks, adjust, write."""
        import json

        from georef_gis.orient.calibration.account import json_account, toml_snippet
        from georef_gis.orient.calibration.field import CalibrationSettings

        settings = CalibrationSettings(lens=parameters.lens, skew=parameters.skew)
        if parameters.shows == "field":
            found = _from_field(parameters, settings)
        else:
            found = _from_board(parameters, settings, feedback)
        for doubt in found.doubts:
            feedback.warn(doubt)
        name = parameters.camera.replace('"', "")
        heading = f'[cameras."{name}"]' if name else "[camera]"
        account = parameters.target.with_suffix(".json")
        write_whole(parameters.target, toml_snippet(found, heading=heading).encode())
        write_whole(account, (json.dumps(json_account(found), indent=2) + "\n").encode())
        feedback.progress(1.0, "written")
        return Result(
            outputs={"section": parameters.target, "account": account}, summary=_summary(found)
        )


def write_whole(target: Path, content: bytes) -> None:
    """Write a file whole or not at all; raises `ExportError` if the disk will not have it."""
    from georef_gis.rasters.files import export_errors, resolve_target, whole_file

    place = resolve_target(target)
    with export_errors(place, lambda: len(content)), whole_file(place) as stream:
        stream.write(content)


def photos_in(folder: Path) -> list[Path]:
    """Photos of a folder by name.

    Raises
    ------
    InputError
        If it is no folder or holds none.
    """
    from georef_gis.errors import InputError

    if not folder.is_dir():
        raise InputError("is not a folder; name the one with the photos", source=str(folder))
    found = sorted(
        Path(name)
        for name in glob.glob(f"{glob.escape(str(folder))}/*")
        if Path(name).suffix.lower() in SUFFIXES
    )
    if not found:
        raise InputError(f"holds no photos ({', '.join(SUFFIXES)})", source=str(folder))
    return found


def _from_board(
    parameters: CalibrateCameraParameters, settings: CalibrationSettings, feedback: Feedback
) -> Calibration:
    from georef_gis.orient.calibration.board import Board, BoardPhoto, calibrate_board
    from georef_gis.toolbox.context import check_cancelled

    board = Board(
        kind="charuco" if parameters.shows == "charuco" else "chessboard",
        across=parameters.across,
        down=parameters.down,
        square_m=parameters.square,
        marker_m=parameters.marker,
        dictionary=parameters.dictionary,
        legacy=parameters.legacy,
        sigma_m=parameters.board_sigma,
    )
    paths = photos_in(parameters.photos)
    done = 0

    def told(photo: str, found: bool) -> None:
        nonlocal done
        done += 1
        check_cancelled(feedback)
        feedback.progress(0.9 * done / len(paths), f"{photo}: {'found' if found else 'no board'}")

    photos = [BoardPhoto(id=path.name, read=_reader(path)) for path in paths]
    return calibrate_board(parameters.camera or "camera", photos, board, settings, told=told)


def _reader(path: Path) -> Any:
    def read() -> Any:
        import numpy as np

        from georef_gis.rasters.reading import read_image

        image = read_image(path)
        if image.dtype == np.uint8 and image.shape[2] == 1:
            return np.ascontiguousarray(image[..., 0])
        grey = image[..., :3].mean(axis=2)
        if image.dtype != np.uint8:
            low, high = np.percentile(grey, [0.5, 99.5])
            grey = (grey - low) * (255.0 / max(float(high - low), 1e-9))
        return np.clip(grey, 0, 255).astype(np.uint8)

    return read


# -- field --------------------------------------------------------------------------------------


def _from_field(
    parameters: CalibrateCameraParameters, settings: CalibrationSettings
) -> Calibration:
    from georef_gis.errors import InputError
    from georef_gis.orient.calibration.field import calibrate_field
    from georef_gis.rasters.reading import read_image

    if parameters.targets is None or parameters.marks is None:
        raise InputError(
            "a field needs targets and marks; give both files",
            source="tool calibrate_camera",
            field="targets",
        )
    targets = read_targets(parameters.targets)
    views = _views(parameters.marks, targets)
    sizes: dict[tuple[int, int], str] = {}
    for view in views:
        path = parameters.photos / view.id
        image = read_image(path)
        sizes.setdefault((image.shape[1], image.shape[0]), view.id)
    if len(sizes) > 1:
        told = " and ".join(f"{w} x {h} ({name})" for (w, h), name in sizes.items())
        raise InputError(
            f"photos of several sizes: {told} px; calibrate those of one size together",
            source=str(parameters.photos),
        )
    from dataclasses import replace

    return calibrate_field(
        parameters.camera or "camera",
        next(iter(sizes)),
        targets,
        views,
        # marks of a file state their sigma
        replace(settings, sigma_px=1.0),
    )


def read_targets(path: Path) -> Targets:
    """Targets of a CSV: name, x, y, z, m, in right-handed axes; sigma, m, where there is one.

    Raises
    ------
    InputError
        Naming file, line, column, value and cure.
    """
    import numpy as np

    from georef_gis.errors import InputError
    from georef_gis.orient.calibration.bundle import Targets

    rows = table_rows(path, ("name", "x", "y", "z"), ("sigma",))
    names = [row.text("name") for row in rows]
    for row, name in zip(rows, names, strict=True):
        if not name or names.count(name) > 1:
            raise InputError(
                f"'{name}' stands for several targets or none; give each one name",
                source=row.source,
                field="name",
            )
    xyz = np.array([[row.required(axis) for axis in "xyz"] for row in rows])
    sigma = np.array([[row.number("sigma") or 0.0] * 3 for row in rows])
    if np.any(sigma < 0):
        raise InputError("sigmas must be >= 0 m", source=str(path), field="sigma")
    return Targets(xyz=xyz, sigma=sigma, names=tuple(names))


def table_rows(path: Path, needed: Sequence[str], also: Sequence[str] = ()) -> list[Any]:
    """Rows of a table with a header by column.

    Raises
    ------
    InputError
        If a column is missing, or there are no rows.
    """
    from georef_gis.errors import InputError
    from georef_gis.ingest.tables import Row, read_lines, separator_of, split

    lines = read_lines(path).data
    if not lines:
        raise InputError("has no columns and rows", source=str(path))
    separator = separator_of(lines[0][1])
    header = [cell.lower() for cell in split(lines[0][1], separator)]
    missing = [name for name in needed if name not in header]
    if missing or len(lines) < 2:
        what = f"column {', '.join(missing)} is missing" if missing else "has no rows"
        raise InputError(f"{what}; the columns are {', '.join([*needed, *also])}", source=str(path))
    columns = {name: i for i, name in enumerate(header)}
    return [
        Row(path=path, line=n, cells=split(line, separator), columns=columns)
        for n, line in lines[1:]
    ]


def read_target_marks(path: Path, targets: Targets) -> list[tuple[str, str, float, float, float]]:
    """Marks of a CSV, name, photo, u, v, maybe sigma_px: as photo, name, u, v, sigma, px.

    Raises
    ------
    InputError
        Naming file, line, column, value and cure.
    """
    from georef_gis.errors import InputError

    known = set(targets.names)
    out = []
    for row in table_rows(path, ("name", "photo", "u", "v"), ("sigma_px",)):
        name, photo, sigma = row.text("name"), row.text("photo"), row.number("sigma_px")
        if name not in known:
            raise InputError(
                f"'{name}' is not among the targets; correct the name or add it",
                source=row.source,
                field="name",
            )
        if not photo or (sigma is not None and sigma <= 0):
            raise InputError("needs a photo, and a sigma > 0 px or none", source=row.source)
        out.append((photo, name, row.required("u"), row.required("v"), sigma or MARK_SIGMA))
    return out


def _views(path: Path, targets: Targets) -> list[View]:
    import numpy as np

    from georef_gis.orient.calibration.bundle import View

    place = {name: i for i, name in enumerate(targets.names)}
    by_photo: dict[str, list[tuple[int, float, float, float]]] = {}
    for photo, name, u, v, sigma in read_target_marks(path, targets):
        by_photo.setdefault(photo, []).append((place[name], u, v, sigma))
    views = []
    for photo, marks in by_photo.items():
        values = np.array(marks)
        views.append(
            View(
                id=photo,
                index=values[:, 0].astype(np.intp),
                uv=values[:, 1:3],
                sigma=values[:, 3],
            )
        )
    return views


def _summary(found: Calibration) -> dict[str, Any]:
    camera = found.camera
    return {
        "photos": len(found.rms_px),
        "left_out": len(found.left_out),
        "fx_px": round(camera.fx, 3),
        "sd_fx_px": round(found.sd["fx"], 3),
        "sigma0": round(found.sigma0, 4),
        "coverage": round(found.coverage, 3),
        "doubts": list(found.doubts),
    }
