"""Assets by their clicks: from a table, measured, and measured again for a joint covariance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.errors import InputError
from georef_gis.measure.assets.asset import FEWEST
from georef_gis.measure.assets.domain import checked_text

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.measure.assets.asset import Asset, Click, Draft, Quality, Vertex
    from georef_gis.measure.assets.domain import Domain
    from georef_gis.measure.assets.thumbnails import Sight
    from georef_gis.measure.measured import MeasuredPoints
    from georef_gis.model.control import Mark
    from georef_gis.project import Project
    from processing_algorithms.measure.session import MeasureSession

# Probability that the ellipse of an asset holds the truth.
CONF = 0.95
# by how little they rest on
_METHODS = ("locate", "intersect", "intersect_ground")
_COLUMNS = ("class", "photo", "u", "v")
_OWN = {*_COLUMNS, "asset", "vertex", "sigma_px", "shared_px", "ground", "note"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Clicked:
    """An asset that somebody clicked; `source` is for messages."""

    kind: str
    name: str
    clicks: tuple[Click, ...]
    attributes: Mapping[str, object] = field(default_factory=dict)
    note: str = ""
    source: str = ""


# -- tables --------------------------------------------------------------------------------------


def read_clicks(path: Path, domain: Domain) -> list[Clicked]:
    """Assets of a CSV: class, photo, u, v, and if wanted asset, vertex, sigma_px, note, attributes.

    Columns shared_px and ground are those of a table of marks. Lines with one `asset` are clicks of
    one asset; a line without is an asset of its own. Vertices count from 1; where the column is
    missing, the clicks of a line or an area in one photo are its vertices in turn, and those of a
    point all show it.

    Raises
    ------
    InputError
        Naming file, line, column and cure.
    """
    from georef_gis.ingest.tables import Row, read_lines, separator_of, split

    data = read_lines(path).data
    separator = separator_of(data[0][1]) if data else ","
    columns = _columns(split(data[0][1], separator) if data else [], str(path))
    groups: dict[str, list[Row]] = {}
    for line, text in data[1:]:
        row = Row(path=path, line=line, cells=split(text, separator), columns=columns)
        groups.setdefault(row.text("asset") or f"\0{line}", []).append(row)
    if not groups:
        raise InputError("holds no clicks below its columns", source=str(path))
    return [_clicked(rows, domain) for rows in groups.values()]


def _columns(cells: Sequence[str], source: str) -> dict[str, int]:
    """Number of each column by its name; our own may be written in capitals."""
    names = [cell.strip() for cell in cells]
    names = [name.lower() if name.lower() in _OWN else name for name in names]
    missing = [column for column in _COLUMNS if column not in names]
    if missing:
        raise InputError(f"has no column {', '.join(missing)}; the first line must name "
                         f"{', '.join(_COLUMNS)}", source=source)  # fmt: skip
    twice = next((name for name in names if name and names.count(name) > 1), None)
    if twice:
        raise InputError(f"has two columns '{twice[:40]}'; keep one", source=source)
    return {name: k for k, name in enumerate(names) if name}


def _clicked(rows: Sequence[Any], domain: Domain) -> Clicked:
    """One asset of its lines; what is not its place may stand on any of them."""
    first = rows[0]
    kinds = {row.text("class") for row in rows} - {""}
    if len(kinds) != 1:
        raise InputError(f"asset '{first.text('asset')[:40]}' is of {len(kinds)} classes; give one",
                         source=first.source, field="class")  # fmt: skip
    kind = kinds.pop()
    try:
        found = domain.find(kind)
        values = {
            name: next((row.text(name) for row in rows if row.text(name)), "")
            for name in first.columns
            if name not in _OWN
        }
        attributes = found.read(values)
        name = checked_text(first.text("asset"))
        note = checked_text(next((row.text("note") for row in rows if row.text("note")), ""))
    except (InputError, ValueError) as error:
        raise InputError(str(error), source=first.source) from error
    clicks = _clicks(rows, is_point=found.geometry == "point")
    count = len({click.vertex for click in clicks})
    if count < FEWEST[found.geometry]:
        raise InputError(
            f"{kind} '{name[:40]}' has {count} vertices; a {found.geometry} has "
            f"{FEWEST[found.geometry]} or more",
            source=first.source,
        )
    return Clicked(kind=kind, name=name, clicks=clicks, attributes=attributes, note=note,
                   source=first.source)  # fmt: skip


def _clicks(rows: Sequence[Any], *, is_point: bool) -> tuple[Click, ...]:
    from georef_gis.ingest.control_tables import on_ground, shared_of
    from georef_gis.measure.assets.asset import Click

    out: list[Click] = []
    for row in rows:
        photo, given = row.text("photo"), row.number("vertex")
        in_photo = sum(click.photo_id == photo for click in out)
        vertex = (0 if is_point else in_photo) if given is None else given - 1
        if vertex < 0 or vertex != int(vertex):
            raise InputError(f"{given:g} is no vertex; they count from 1", source=row.source,
                             field="vertex")  # fmt: skip
        out.append(
            Click(
                photo_id=photo,
                u=row.required("u"),
                v=row.required("v"),
                vertex=int(vertex),
                sigma_px=row.number("sigma_px"),
                shared_px=shared_of(row),
                on_ground=on_ground(row),
            )
        )
    vertices = sorted({click.vertex for click in out})
    if vertices != list(range(len(vertices))):
        raise InputError("its vertices leave some out; number them 1, 2, 3 ...",
                         source=rows[0].source, field="vertex")  # fmt: skip
    return tuple(out)


# -- measuring -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredDraft:
    """A clicked asset with its place, or why it has none; `doubts` are one line each."""

    clicked: Clicked
    draft: Draft | None
    refused: str = ""
    doubts: tuple[str, ...] = ()


def measure_clicked(
    session: MeasureSession, clicked: Sequence[Clicked], *, sigma_px: float
) -> list[MeasuredDraft]:
    """Assets with their places; vertices in one photo by the ground, others by their rays.

    One whose photo is not known is refused, the others are measured.

    Parameters
    ----------
    sigma_px
        One sigma of a click that states none, px; it is kept with the click, so that the asset is
        measured again as it was.

    Raises
    ------
    InputError
        If one has two clicks in a photo.
    """
    known = [_with_ids(session, _sure(one, sigma_px)) for one in clicked]
    marks = [
        mark
        for k, one in enumerate(known)
        if isinstance(one, Clicked)
        for mark in _marks(k, one.clicks, sigma_px)
    ]
    points = session.measure(marks, on_fail="skip")
    at = {name: i for i, name in enumerate(points.names)}
    return [
        _draft(points, at, k, one) if isinstance(one, Clicked) else one
        for k, one in enumerate(known)
    ]


def _sure(one: Clicked, sigma_px: float) -> Clicked:
    clicks = (replace(c, sigma_px=sigma_px) if c.sigma_px is None else c for c in one.clicks)
    return replace(one, clicks=tuple(clicks))


def _with_ids(session: MeasureSession, one: Clicked) -> Clicked | MeasuredDraft:
    """Asset with the ids of its photos; or why it has no place, where one is not there."""
    try:
        clicks = tuple(replace(c, photo_id=session.photo_id(c.photo_id)) for c in one.clicks)
    except InputError as error:
        return MeasuredDraft(clicked=one, draft=None, refused=str(error))
    seen: set[tuple[str, int]] = set()
    for click in clicks:
        if (click.photo_id, click.vertex) in seen:
            raise InputError(
                f"photo {click.photo_id} shows {one.kind} '{one.name[:40]}' twice; keep one click, "
                "or give another asset another name",
                source=one.source,
            )
        seen.add((click.photo_id, click.vertex))
    return replace(one, clicks=clicks)


def _marks(number: int, clicks: Sequence[Click], sigma_px: float) -> list[Mark]:
    return [mark_of(_point_name(number, click.vertex), click, sigma_px) for click in clicks]


def mark_of(name: str, click: Click, sigma_px: float) -> Mark:
    """A click as what is measured; `sigma_px` where it states none, px."""
    from georef_gis.model.control import Mark

    return Mark(
        name=name,
        photo=click.photo_id,
        u=click.u,
        v=click.v,
        sigma_px=sigma_px if click.sigma_px is None else click.sigma_px,
        shared_px=click.shared_px,
        on_ground=click.on_ground,
    )


def _point_name(number: int, vertex: int) -> str:
    return f"{number}/{vertex}"


def _draft(
    points: MeasuredPoints, at: Mapping[str, int], number: int, clicked: Clicked
) -> MeasuredDraft:
    from georef_gis.measure.assets.asset import Draft

    vertices = sorted({click.vertex for click in clicked.clicks})
    names = [_point_name(number, vertex) for vertex in vertices]
    lost = next((name for name in names if name not in at), None)
    if lost is not None:
        why = points.refused.get(lost, "has no place")
        return MeasuredDraft(clicked=clicked, draft=None, refused=why.removeprefix(f"{lost}: "))
    indices = [at[name] for name in names]
    draft = Draft(
        kind=clicked.kind,
        name=clicked.name,
        note=clicked.note,
        attributes=clicked.attributes,
        vertices=map_vertices(points, indices),
        quality=measured_quality(points, indices, clicked.clicks),
    )
    doubts = tuple(line for i in indices for line in points.doubts[i])
    return MeasuredDraft(clicked=clicked, draft=draft, doubts=doubts)


def map_vertices(points: MeasuredPoints, indices: Sequence[int]) -> tuple[Vertex, ...]:
    """Places on the map: units of the CRS, heights in m above the ellipsoid."""
    xyz = points.scene.frame.map_from_enu(points.p_enu[list(indices)])
    return tuple((float(x), float(y), float(z)) for x, y, z in xyz)


def measured_quality(
    points: MeasuredPoints, indices: Sequence[int], clicks: Sequence[Click]
) -> Quality:
    """How far to trust measured vertices: what holds for the worst of them."""
    from georef_gis.measure.assets.asset import Quality
    from georef_gis.measure.ellipses import error_ellipse, on_map

    chosen = list(indices)
    spread = on_map(points.scene.frame, points.p_enu[chosen], points.each[chosen])
    ellipses = [error_ellipse(C, conf=CONF) for C in spread]
    worst = max(range(len(chosen)), key=lambda k: ellipses[k].semi_major)
    C, ellipse = spread[worst], ellipses[worst]
    sigma = [math.sqrt(max(float(C[k, k]), 0.0)) for k in range(3)]
    both = sigma[0] * sigma[1]
    each = [points[i] for i in chosen]
    return Quality(
        sigma_e=sigma[0],
        sigma_n=sigma[1],
        sigma_u=sigma[2],
        corr_en=max(-1.0, min(1.0, float(C[0, 1]) / both)) if both > 0.0 else 0.0,
        semi_major=ellipse.semi_major,
        semi_minor=ellipse.semi_minor,
        azimuth=math.degrees(ellipse.azimuth),
        conf=CONF,
        dof=min(point.dof for point in each),
        n_rays=min(point.n_rays for point in each),
        # of its vertices the way that rests on least
        method=min((p.method for p in each), key=_METHODS.index),
        clicks=tuple(clicks),
    )


def remeasured(
    session: MeasureSession, assets: Sequence[Asset], *, sigma_px: float
) -> list[tuple[Asset, MeasuredDraft]]:
    """Assets that have clicks on all their vertices, measured with the poses of now."""
    clicked = [
        (asset, Clicked(kind=asset.kind, name=asset.name, clicks=asset.quality.clicks))
        for asset in assets
        if asset.quality is not None and is_clicked(asset)
    ]
    found = measure_clicked(session, [one for _, one in clicked], sigma_px=sigma_px)
    return [(asset, one) for (asset, _), one in zip(clicked, found, strict=True)]


def remeasured_points(
    project: Project, assets: Sequence[Asset], *, sigma_px: float
) -> tuple[Array, Array]:
    """Vertices of clicked assets, asset by asset, (n, 3) m, and their joint covariance, m^2.

    Raises
    ------
    GeometryError
        If one has no place any more.
    """
    from processing_algorithms.measure.session import MeasureSession

    session = MeasureSession.open(project)
    marks, order = [], []
    for k, asset in enumerate(assets):
        assert asset.quality is not None
        marks += _marks(k, asset.quality.clicks, sigma_px)
        order += [_point_name(k, vertex) for vertex in range(len(asset.vertices))]
    points = session.measure(marks)
    at = {name: i for i, name in enumerate(points.names)}
    points = points.subset([at[name] for name in order])
    return points.p_enu, points.covariance()


def is_clicked(asset: Asset) -> bool:
    """Whether every vertex of an asset has a click."""
    if asset.quality is None or not asset.vertices:
        return False
    return {c.vertex for c in asset.quality.clicks} == set(range(len(asset.vertices)))


# -- pictures ------------------------------------------------------------------------------------


def sights_of(session: MeasureSession, assets: Sequence[Asset]) -> dict[str, Sight]:
    """Where to cut a picture of each asset that was clicked, by its id."""
    import numpy as np

    from georef_gis.measure.assets.thumbnails import Sight, best_sight

    out = {}
    for asset in assets:
        if asset.quality is None or not asset.vertices:
            continue
        place = np.array(asset.vertices[0], dtype=np.float64)
        p_enu = session.frame.enu_from_map(np.nan_to_num(place))
        sights = []
        for photo_id in asset.quality.photo_ids:
            if photo_id not in session.site.photos:
                continue
            photo = session.site.photos[photo_id]
            clicks = [c for c in asset.quality.clicks if c.photo_id == photo_id]
            clicks.sort(key=lambda click: click.vertex)
            known = math.isfinite(place[2])
            distance = float(np.linalg.norm(p_enu - photo.pose.origin_enu)) if known else math.nan
            sights.append(
                Sight(
                    photo_id=photo_id,
                    path=photo.photo.path,
                    uv=np.array([[c.u, c.v] for c in clicks]),
                    gsd=distance / photo.camera.fx,
                    closed=asset.shape == "polygon",
                )
            )
        if sights:
            out[asset.id] = best_sight(sights)
    return out
