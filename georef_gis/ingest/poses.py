"""Positions and angles of photos from text files instead of tags."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Literal, get_args

from georef_gis.errors import InputError
from georef_gis.geodesy import CRS, Height, HeightKind
from georef_gis.ingest.poses_angles import attitude_of, check_angle_unit, sigma_of
from georef_gis.ingest.poses_blocks import Placing, block_format, read_block_poses
from georef_gis.ingest.poses_places import geo_of
from georef_gis.ingest.poses_table import PoseFormat, pose_table
from georef_gis.ingest.tables import Lines, Row, height_of, height_unit, parse_table_crs, read_lines
from georef_gis.model.photo import AttitudeTag, Geotag

FORMATS: tuple[PoseFormat, ...] = get_args(PoseFormat)
PoseOfFile = tuple[Geotag, AttitudeTag | None]


def read_poses(
    path: Path,
    *,
    format: PoseFormat = "auto",
    crs: str | None = None,
    angle_unit: Literal["degrees", "radians"] = "degrees",
    near: tuple[float, float] | None = None,
    placing: Placing | None = None,
) -> dict[str, PoseOfFile]:
    """Positions and, where given, angles by photo name as the file writes it.

    Parameters
    ----------
    path
        ODM geo.txt, or reference CSV of Metashape, Pix4D or orthority; OpenSfM's
        reconstruction.json; images.txt or the folder of a COLMAP text model.
    format
        Its format; "auto" tells by the first lines.
    crs
        CRS where the file names none; otherwise WGS 84.
    angle_unit
        Unit of the angles.
    near : (lat, lon), rad
        Where the photos are by their own tags: finds swapped coordinates and wrong units.
    placing
        Puts a block of OpenSfM or COLMAP that lies nowhere on the Earth, by the photos' tags.

    Returns
    -------
    poses
        Angles in dialect `ypr` (zero at nadir) or `opk` (roll = omega, pitch = phi, yaw = kappa).

    Raises
    ------
    InputError
        Naming file, line, column, value and cure.
    """
    if format not in FORMATS:
        raise InputError(
            f"'{format}' is not known; use one of {', '.join(FORMATS)}", field="[poses] format"
        )
    block = block_format(path, format)
    if block is not None:
        found = read_block_poses(
            path, block, placing=placing, read_positions=lambda file: _positions(file, near)
        )
        return dict(found)
    lines = read_lines(path)
    table = pose_table(lines, format)
    used = parse_table_crs(table.crs_text or crs or "EPSG:4326", f"{path}, crs")
    unit = height_unit(lines, used)
    unit_of_sigmas = _accuracy_unit(lines, used)
    check_angle_unit(table.rows, angle_unit)
    to_geo = geo_of(used, near, table)
    out: dict[str, PoseOfFile] = {}
    seen: dict[str, int] = {}
    for row in table.rows:
        name = _name_of(row, seen)
        lat, lon = to_geo(row)
        geotag = Geotag(
            lat=lat,
            lon=lon,
            height=_height(row.number("z", "z"), used, lines, unit),
            sigma_h=sigma_of(row, "acc_h", unit_of_sigmas),
            sigma_v=sigma_of(row, "acc_v", unit_of_sigmas),
            source=path.name,
        )
        out[name] = geotag, attitude_of(row, angle_unit)
    return out


def _name_of(row: Row, seen: dict[str, int]) -> str:
    """Name of a row's photo, which joins those `seen` so far, in lower case, with their lines."""
    name = row.text("name")
    if not name:
        raise InputError("the photo's name is missing", source=row.source, field="name")
    if name.lower() in seen:
        raise InputError(
            f"'{name}' stands in line {seen[name.lower()]} too; keep one of the two",
            source=row.source,
            field="name",
        )
    seen[name.lower()] = row.line
    return name


def _positions(path: Path, near: tuple[float, float] | None) -> dict[str, Geotag]:
    """Positions of ODM's geo.txt by name."""
    return {name: tag for name, (tag, _) in read_poses(path, format="odm", near=near).items()}


def _accuracy_unit(lines: Lines, crs: CRS) -> float:
    """Length of the unit of accuracies, m, by a line such as `# accuracy_unit: US survey foot`."""
    value = lines.header.get("accuracy_unit", "")
    return height_unit(replace(lines, header={"height_unit": value}), crs)


def _height(value: float | None, crs: CRS, lines: Lines, unit: float) -> Height | None:
    """Height by the vertical part of the CRS, else by what a line such as `# heights: ...` says."""
    height = height_of(value, crs)
    if height is None or height.kind is not HeightKind.UNKNOWN:
        return height
    words = lines.header.get("heights", "").lower()
    kind = HeightKind.UNKNOWN
    if words.startswith("ellipsoidal"):
        kind = HeightKind.ELLIPSOIDAL
    elif words.startswith("orthometric (egm96)"):
        kind = HeightKind.ORTHOMETRIC
    return replace(height, value=height.value * unit, kind=kind)


def match_poses(
    poses: Mapping[str, PoseOfFile], names: Iterable[str]
) -> tuple[dict[str, PoseOfFile], tuple[str, ...]]:
    """Poses by photo name, and the names in the file that no photo has.

    Parameters
    ----------
    poses
        As `read_poses` gives them.
    names
        File names of the photos. Names match in either case, with or without folder and ending.

    Returns
    -------
    matched, left_over
    """
    by_name: dict[str, str] = {}
    for name in names:
        base = PurePosixPath(name.replace("\\", "/")).name.lower()
        by_name.setdefault(base, name)
        by_name.setdefault(_stem(base), name)
    matched: dict[str, PoseOfFile] = {}
    left: list[str] = []
    for written, pose in poses.items():
        base = PurePosixPath(written.replace("\\", "/")).name.lower()
        photo = by_name.get(base) or by_name.get(_stem(base))
        if photo is None:
            left.append(written)
        else:
            matched[photo] = pose
    return matched, tuple(left)


def _stem(name: str) -> str:
    return re.sub(r"\.(jpe?g|tiff?|png|dng)$", "", name)
