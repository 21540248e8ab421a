"""What the report page tells, read from a project: database, adjustment, products."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, metres_per_unit
from georef_gis.model.camera import Camera
from georef_gis.model.layers import Footprint
from georef_gis.model.pose import Pose
from georef_gis.project import Database, Project
from georef_gis.project.columns_file import read_columns
from georef_gis.project.records import camera_of, footprint_of, load_frame, pose_of
from georef_gis.rasters.preview import Preview, read_preview

DONE = "done"
ADJUST, MATCH, MOSAIC, ACCURACY = "adjust", "match", "mosaic", "accuracy"
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Heights:
    """Heights of the ground on a grid, north up.

    Parameters
    ----------
    z : shape (rows, cols), m
        Above the ellipsoid; NaN where there is none.
    seen : shape (rows, cols), bool
        Where a photo shows it.
    sigma : shape (rows, cols), m
        One sigma, if the ground tells it by place.
    extent
        Left, right, bottom, top, m from `Facts.corner`.
    """

    z: Array
    seen: NDArray[np.bool_]
    sigma: Array | None
    extent: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """Residuals of an adjustment, observed less computed.

    Parameters
    ----------
    photo_ids
        What `photo` counts.
    photo : shape (m,)
    uv, residual : shape (m, 2), px of the sensor
    sigma : shape (m,), px
    """

    photo_ids: tuple[str, ...]
    photo: NDArray[np.int32]
    uv: Array
    residual: Array
    sigma: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Accuracy:
    """An accuracy statement: text, values, pictures by file name."""

    text: str
    values: Mapping[str, Any]
    pictures: Mapping[str, bytes]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjustment:
    """What an adjustment left; `report` is its adjustment/report.json."""

    report: Mapping[str, Any]
    residuals: Residuals | None
    points_enu: Array
    points_px: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Facts:
    """A project as its report page sees it.

    Parameters
    ----------
    corner
        South-west corner of the footprints, CRS units: places in the pictures count from it.
    unit
        Metres per CRS unit.
    photos, flights, control, marks
        Rows of these tables.
    direct, adjusted
        Poses by photo, without and with matching; `turned` of each kind, deg.
    cameras
        By id, the adjusted ones among them.
    doubtful
        What is doubtful about the poses that are used, by photo; photos without doubt are absent.
    settled
        Photos whose tags were doubtful before they were adjusted.
    runs
        Last run of every tool, in the order in which they began.
    missing
        Files that should be there and cannot be read, one line each.
    """

    title: str
    frame: MapFrame
    corner: Array
    unit: float
    quick: bool
    photos: Sequence[Row]
    flights: Sequence[Row]
    control: Sequence[Row]
    marks: Sequence[Row]
    footprints: Mapping[str, Footprint]
    footprint_rows: Sequence[Row]
    direct: Mapping[str, Pose]
    adjusted: Mapping[str, Pose]
    turned: Mapping[str, Mapping[str, int]]
    doubtful: Mapping[str, Sequence[str]]
    settled: Sequence[str]
    height_kinds: tuple[str, ...]
    cameras: Mapping[str, Camera]
    camera_rows: Sequence[Row]
    runs: Sequence[Row]
    ground: Mapping[str, Any]
    mosaic: Preview | None
    overlap: Preview | None
    matches: Mapping[str, Any] | None
    adjustment: Adjustment | None
    accuracy: Accuracy | None
    missing: tuple[str, ...] = field(default=())

    def run_of(self, tool: str) -> Row | None:
        """Last run of a tool of ours."""
        found = [run for run in self.runs if run["tool"].rpartition(":")[2] == tool]
        return found[-1] if found else None

    def local(self, xy_map: Array) -> Array:
        """Metres east and north of the corner of map places; (..., 2) CRS units."""
        return np.asarray((np.asarray(xy_map)[..., :2] - self.corner) * self.unit)

    def local_of_enu(self, p_enu: Array) -> Array:
        """Metres east and north of the corner, of places in enu; (..., 3) m."""
        return self.local(self.frame.map_from_enu(p_enu))

    def local_extent(self, preview: Preview) -> tuple[float, float, float, float]:
        """Left, right, bottom, top of a raster, m from the corner."""
        left, right, bottom, top = preview.extent
        (x0, y0), (x1, y1) = self.local(np.array([[left, bottom], [right, top]]))
        return float(x0), float(x1), float(y0), float(y1)


def read_facts(project: Project, *, quick: bool = False) -> Facts:
    """Read a project; with `quick` nothing that came after the direct result.

    Raises
    ------
    InputError
        If there are no footprints yet.
    """
    database = project.database
    frame = load_frame(database)
    rows = _valid_footprints(project)
    footprints = {row["photo_id"]: footprint_of(row) for row in rows}
    rings = np.vstack([f.ring_map for f in footprints.values()])
    runs = sorted(database.last_rows("run", "tool"), key=lambda row: row["fid"])
    poses = _pose_rows(database, quick)
    doubtful = _doubtful(rows, poses.adjusted.values())
    camera_rows = database.rows("camera")
    missing: list[str] = []
    return Facts(
        title=project.settings.project.name or project.folder.name,
        frame=frame,
        corner=rings.min(axis=0),
        unit=metres_per_unit(frame.horizontal),
        quick=quick,
        photos=database.rows("photo"),
        flights=database.rows("flight"),
        control=database.rows("control"),
        marks=database.rows("mark"),
        footprints=footprints,
        footprint_rows=rows,
        direct={key: pose_of(row) for key, row in poses.direct.items()},
        adjusted={key: pose_of(row) for key, row in poses.adjusted.items()},
        turned={"direct": _turned(poses.direct), "adjusted": _turned(poses.adjusted)},
        doubtful=doubtful,
        settled=[row["photo_id"] for row in rows if row["doubts"]
                 and row["photo_id"] in poses.adjusted and row["photo_id"] not in doubtful],
        height_kinds=poses.height_kinds(),
        cameras={row["camera_id"]: camera_of(row) for row in camera_rows},
        camera_rows=camera_rows,
        runs=runs,
        ground=_ground(database, adjusted=bool(poses.adjusted)),
        mosaic=_mosaic(project, runs, missing),
        overlap=_raster(project.products / "overlap.tif", missing, average=False),
        matches=None if quick else _json(project.adjustment / "matches.json", missing),
        adjustment=_adjustment(project, missing) if poses.adjusted else None,
        accuracy=_accuracy(project, runs, missing),
        missing=tuple(missing),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PoseRows:
    """Rows of poses by photo: of the direct ones the best, and the adjusted."""

    direct: Mapping[str, Row]
    adjusted: Mapping[str, Row]

    def height_kinds(self) -> tuple[str, ...]:
        """What is said of the heights of the poses that are used."""
        used = {**self.direct, **self.adjusted}.values()
        return tuple(sorted({(row["extra"] or {}).get("height_kind") or "unknown" for row in used}))


def _pose_rows(database: Database, quick: bool) -> _PoseRows:
    kinds = ("tags",) if quick else ("tags", "navigation")
    adjusted = () if quick else database.rows("pose", {"kind": "adjusted"})
    return _PoseRows(
        direct={
            row["photo_id"]: row for kind in kinds for row in database.rows("pose", {"kind": kind})
        },
        adjusted={row["photo_id"]: row for row in adjusted},
    )


def _ground(database: Database, *, adjusted: bool) -> Mapping[str, Any]:
    found = database.meta("ground_adjusted") if adjusted else None
    return found or database.meta("ground") or {}


def _valid_footprints(project: Project) -> list[dict[str, Any]]:
    rows = project.database.rows("footprint")
    if not rows:
        raise InputError(
            "no photo has a place on the ground; `georef run` makes them, or says why not",
            source=str(project.database.path),
        )
    return rows


def _doubtful(footprints: Sequence[Row], adjusted: Iterable[Row]) -> dict[str, list[str]]:
    """Doubts by photo; of an adjusted one those of its pose, as the pixels settle the tags'."""
    found = {row["photo_id"]: list(row["doubts"] or ()) for row in footprints}
    found |= {row["photo_id"]: list(row["doubts"] or ()) for row in adjusted}
    return {key: doubts for key, doubts in found.items() if doubts}


def _turned(rows: Mapping[str, Row]) -> dict[str, int]:
    return {key: int((row["extra"] or {}).get("turned_deg", 0)) for key, row in rows.items()}


def _mosaic(project: Project, runs: Sequence[Row], missing: list[str]) -> Preview | None:
    """The mosaic that the last run made; one left by an older run is not shown."""
    for name in _products(runs, MOSAIC):
        return _raster(project.path(name), missing)
    return None


def _products(runs: Sequence[Row], tool: str) -> list[str]:
    for run in runs:
        if run["tool"].rpartition(":")[2] == tool and run["outcome"] == DONE:
            return list((run["summary"] or {}).get("products", ()))
    return []


def _raster(path: Path, missing: list[str], *, average: bool = True) -> Preview | None:
    if not path.is_file():
        missing.append(f"{path.name} is not there")
        return None
    try:
        return read_preview(path, average=average)
    except InputError as error:
        missing.append(str(error))
        return None


def _json(path: Path, missing: list[str]) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        missing.append(f"{path.name} cannot be read ({error})")
        return None
    return found if isinstance(found, dict) else None


def _adjustment(project: Project, missing: list[str]) -> Adjustment | None:
    report = _json(project.adjustment / "report.json", missing)
    if report is None:
        return None
    residuals, places, pixels = None, np.zeros((0, 3)), np.zeros(0)
    try:
        read = read_columns(project.adjustment / "residuals.npz", "residuals")
        seen = np.isfinite(read["residual"]).all(axis=1)
        residuals = Residuals(
            photo_ids=tuple(str(name) for name in read["photo_ids"]),
            photo=read["photo"][seen], uv=read["uv"][seen].astype(np.float64),
            residual=read["residual"][seen].astype(np.float64),
            sigma=read["sigma"][seen].astype(np.float64),
        )  # fmt: skip
        points = read_columns(project.adjustment / "points.npz", "ground points")
        known = np.isfinite(points["p_enu"]).all(axis=1) & np.isfinite(points["residual_px"])
        places, pixels = points["p_enu"][known], points["residual_px"][known].astype(np.float64)
    except InputError as error:
        missing.append(str(error))
    return Adjustment(report=report, residuals=residuals, points_enu=places, points_px=pixels)


def _accuracy(project: Project, runs: Sequence[Row], missing: list[str]) -> Accuracy | None:
    """The statement that the last run wrote."""
    if not _products(runs, ACCURACY):
        return None
    values = _json(project.products / "accuracy.json", missing)
    try:
        text = (project.products / "accuracy.txt").read_text(encoding="utf-8")
        pictures = {
            path.name: path.read_bytes() for path in sorted(project.products.glob("accuracy_*.png"))
        }
    except OSError as error:
        missing.append(f"accuracy.txt cannot be read ({error.strerror})")
        return None
    if values is None:
        return None
    return Accuracy(text=text, values=values, pictures=pictures)


def place_of(row: Row) -> Array | None:
    """Map place of a control point, x y in CRS units; None where it has none."""
    return None if row["geom"] is None else np.array(struct.unpack("<dd", row["geom"][5:21]))
