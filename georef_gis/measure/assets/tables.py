"""Layers of ``assets.gpkg``, and rows of them from assets and back."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from georef_gis.errors import InputError
from georef_gis.measure.assets.asset import Asset, Click, Quality, Vertex
from georef_gis.measure.assets.domain import Domain, Shape
from georef_gis.project.geometry import Bounds, from_blob, to_blob
from georef_gis.project.schema import Table

# Column -> field of Quality
QUALITY_COLUMNS = {
    "sigma_e": "REAL", "sigma_n": "REAL", "sigma_u": "REAL", "corr_en": "REAL",
    "semi_major": "REAL", "semi_minor": "REAL", "azimuth": "REAL", "conf": "REAL",
    "dof": "INTEGER", "n_rays": "INTEGER", "method": "TEXT",
}  # fmt: skip
CLICK_COLUMNS = {"photo_ids": "TEXT", "pixels": "TEXT"}
COLUMNS = {
    "asset_id": "TEXT", "class": "TEXT", "name": "TEXT", "attributes": "TEXT", "note": "TEXT",
    **QUALITY_COLUMNS, **CLICK_COLUMNS, "created": "TEXT", "changed": "TEXT",
}  # fmt: skip
LAYERS: Mapping[Shape, Table] = {
    "point": Table(
        name="asset_points", description="Assets that are points; sigmas and axes in m",
        geometry="POINT", has_z=True, columns=COLUMNS,
    ),
    "line": Table(
        name="asset_lines", description="Assets that are lines; sigmas of the worst vertex, m",
        geometry="LINESTRING", has_z=True, columns=COLUMNS,
    ),
    "polygon": Table(
        name="asset_polygons", description="Assets that are areas; sigmas of the worst vertex, m",
        geometry="POLYGON", has_z=True, columns=COLUMNS,
    ),
}  # fmt: skip
ELLIPSES = Table(
    name="asset_ellipses",
    description="Error ellipses of the points, made from their columns; edits here are lost",
    geometry="POLYGON",
    columns={"asset_id": "TEXT", "class": "TEXT", "name": "TEXT", "semi_major": "REAL",
             "semi_minor": "REAL", "azimuth": "REAL", "conf": "REAL"},
)  # fmt: skip
# What an asset was when last looked at: an unequal row was edited by another program. Kept, with
# no content, after it was deleted, so that its revisions go on when that is undone.
KNOWN = Table(
    name="asset_known",
    description="Revision and content of every asset; leave it as it is",
    key=("asset_id",),
    columns={"asset_id": "TEXT", "revision": "INTEGER", "layer": "TEXT", "fid_in_layer": "INTEGER",
             "content": "TEXT"},
)  # fmt: skip
HISTORY = Table(
    name="asset_history",
    description="Every edit with what was before and after; leave it as it is",
    columns={"step": "INTEGER", "state": "TEXT", "title": "TEXT", "at": "TEXT",
             "asset_id": "TEXT", "layer": "TEXT", "before": "TEXT", "after": "TEXT"},
)  # fmt: skip
TABLES = (*LAYERS.values(), ELLIPSES, KNOWN, HISTORY)
SHAPE_OF: Mapping[str, Shape] = {table.name: shape for shape, table in LAYERS.items()}

# A row without fid: column -> value, and "geom" -> WKB
Row = dict[str, Any]


# -- assets and rows -----------------------------------------------------------------------------


def row_of(asset: Asset) -> Row:
    """Row of an asset."""
    quality = asset.quality or Quality()
    clicks = [_written(click) for click in quality.clicks]
    return {
        "asset_id": asset.id,
        "class": asset.kind,
        "name": asset.name,
        "attributes": json.dumps(dict(asset.attributes), ensure_ascii=False),
        "note": asset.note,
        **{name: getattr(quality, name) for name in QUALITY_COLUMNS},
        "method": quality.method or None,
        "photo_ids": json.dumps(quality.photo_ids, ensure_ascii=False) if clicks else None,
        "pixels": json.dumps(clicks, ensure_ascii=False) if clicks else None,
        "created": asset.created,
        "changed": asset.changed,
        "geom": wkb_of(asset.shape, asset.vertices),
    }


def _written(click: Click) -> list[Any]:
    """A click as older versions write it, and what is more of it where there is any."""
    out = [click.photo_id, click.u, click.v, click.vertex, click.sigma_px]
    more = [click.shared_px, click.on_ground]
    return out + more if any(more) else out


def asset_of(row: Mapping[str, Any], shape: Shape, revision: int, domain: Domain) -> Asset:
    """Asset of a row, whatever a GIS made of it; what does not fit stands in `problems`."""
    problems: list[str] = []
    kind = _text(row.get("class"))
    attributes = _attributes(row.get("attributes"), problems)
    vertices = _vertices(row.get("geom"), shape, problems)
    found = domain.classes.get(kind)
    if found is None:
        problems.append(f"class {kind[:40]!r} is not known")
    elif found.geometry != shape:
        problems.append(f"class {kind!r} is a {found.geometry}, but it was drawn as a {shape}")
    else:
        problems += _unfit(found, attributes)
    problems += unsound(shape, vertices)
    return Asset(
        id=_text(row.get("asset_id")),
        kind=kind,
        shape=shape,
        vertices=vertices,
        name=_text(row.get("name")),
        note=_text(row.get("note")),
        attributes=attributes,
        quality=_quality(row, problems),
        revision=revision,
        created=_text(row.get("created")),
        changed=_text(row.get("changed")),
        problems=tuple(problems),
    )


def _unfit(found: Any, attributes: Mapping[str, Any]) -> list[str]:
    try:
        found.read(attributes)
    except InputError as error:
        return [str(error)]
    return []


def _attributes(text: Any, problems: list[str]) -> dict[str, Any]:
    if text in (None, ""):
        return {}
    try:
        read = json.loads(text)
    except (TypeError, ValueError):
        read = None
    if isinstance(read, dict):
        return read
    problems.append('attributes are no JSON object such as {"line": "T1"}')
    return {}


def _quality(row: Mapping[str, Any], problems: list[str]) -> Quality | None:
    values = {name: row.get(name) for name in QUALITY_COLUMNS}
    clicks = _clicks(row.get("pixels"), problems)
    if not clicks and all(value in (None, "") for value in values.values()):
        return None
    known = {field.name for field in fields(Quality)}
    try:
        numbers = {
            name: None if value is None else int(value) if name in ("dof", "n_rays") else
            float(value) for name, value in values.items() if name != "method" and name in known
        }  # fmt: skip
        return Quality(method=_text(values["method"]), clicks=clicks, **numbers)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        problems.append(f"its accuracy cannot be read ({error})")
        return None


def _clicks(text: Any, problems: list[str]) -> tuple[Click, ...]:
    if text in (None, ""):
        return ()
    try:
        clicks = tuple(
            Click(photo_id=str(photo), u=float(u), v=float(v), vertex=int(vertex),
                  sigma_px=None if sigma is None else float(sigma),
                  shared_px=float(more[0]) if more else 0.0, on_ground=more[1:] == [True])
            for photo, u, v, vertex, sigma, *more in json.loads(text)
        )  # fmt: skip
    except (OverflowError, TypeError, ValueError):
        clicks = None
    if clicks is None or not all(math.isfinite(c.u) and math.isfinite(c.v) for c in clicks):
        problems.append("its pixels cannot be read")
        return ()
    return clicks


def _text(value: Any) -> str:
    return "" if value is None else str(value)


# -- geometry ------------------------------------------------------------------------------------


def wkb_of(shape: Shape, vertices: tuple[Vertex, ...]) -> bytes:
    """ISO WKB, with z if every vertex has a height."""
    import shapely

    has_z = all(not math.isnan(z) for _, _, z in vertices)
    points = [v if has_z else v[:2] for v in vertices]
    make = {"point": lambda p: shapely.Point(p[0]), "line": shapely.LineString,
            "polygon": shapely.Polygon}[shape]  # fmt: skip
    wkb: bytes = shapely.to_wkb(make(points), byte_order=1, flavor="iso")
    return wkb


def _vertices(wkb: bytes | None, shape: Shape, problems: list[str]) -> tuple[Vertex, ...]:
    """Vertices of a geometry; of a multiple one or one with holes, those of its first ring."""
    import shapely

    if wkb is None:
        problems.append("has no geometry")
        return ()
    try:
        geometry = shapely.from_wkb(wkb)
    except (shapely.errors.GEOSException, TypeError) as error:
        problems.append(f"its geometry cannot be read ({str(error).splitlines()[0]})")
        return ()
    kind = {"point": "Point", "line": "LineString", "polygon": "Polygon"}[shape]
    if geometry.geom_type == f"Multi{kind}" and len(geometry.geoms) == 1:
        geometry = geometry.geoms[0]
    if geometry.is_empty or geometry.geom_type != kind:
        problems.append(f"is {'empty' if geometry.is_empty else f'a {geometry.geom_type}'}, "
                        f"not a {shape}")  # fmt: skip
        return ()
    if shape == "polygon":
        if len(geometry.interiors):
            problems.append("has holes, which are not measured")
        geometry = geometry.exterior
    xyz = shapely.get_coordinates(geometry, include_z=True)
    xyz = xyz[:-1] if shape == "polygon" else xyz
    return tuple((float(x), float(y), float(z)) for x, y, z in xyz)


def unsound(shape: Shape, vertices: tuple[Vertex, ...]) -> list[str]:
    """What keeps a line from having a length, or an outline from having an area."""
    import shapely

    if shape == "point" or not vertices:
        return []
    if len({vertex[:2] for vertex in vertices}) == 1:
        return ["all its vertices lie at one place"]
    if shape == "line" or shapely.Polygon([vertex[:2] for vertex in vertices]).is_valid:
        return []
    return ["its outline crosses or touches itself; click its corners one after the other, around"]


def blob_of(wkb: bytes | None, srs_id: int) -> tuple[bytes | None, Bounds | None]:
    """GeoPackage blob of a WKB, and its bounds."""
    return (None, None) if wkb is None else to_blob(wkb, srs_id)


def wkb_in(blob: Any) -> bytes | None:
    """WKB of a GeoPackage blob; None of what is none."""
    if not isinstance(blob, bytes) or len(blob) < 8 or blob[:2] != b"GP":
        return None
    return from_blob(blob)


def ellipse_wkb(asset: Asset, unit: float) -> bytes | None:
    """Polygon of a point's error ellipse; None without one. `unit` is m per CRS unit."""
    import shapely

    from georef_gis.measure.ellipses import Ellipse

    q = asset.quality
    if asset.shape != "point" or not asset.vertices or q is None:
        return None
    if q.semi_major is None or q.semi_minor is None or q.azimuth is None or q.semi_major == 0.0:
        return None
    ellipse = Ellipse(
        semi_major=q.semi_major, semi_minor=q.semi_minor, azimuth=math.radians(q.azimuth)
    )
    ring = ellipse.polygon(asset.vertices[0][:2], unit=unit)
    wkb: bytes = shapely.to_wkb(shapely.Polygon(ring), byte_order=1)
    return wkb


# -- content of a row as text --------------------------------------------------------------------


def content_of(row: Row) -> str:
    """A row as JSON: what is kept to be undone, and compared to find edits of other programs."""
    return json.dumps(
        {key: _coded(value) for key, value in row.items()}, ensure_ascii=False, sort_keys=True
    )


def row_in(content: str) -> Row:
    """Row of a content.

    Raises
    ------
    InputError
        If another program wrote into the store's own tables.
    """
    try:
        read: Row = json.loads(content)
        return {key: _decoded(value) for key, value in read.items()}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"what {KNOWN.name} and {HISTORY.name} hold cannot be read, another "
                         "program changed it; put a copy of the file in its place",
                         source="assets.gpkg") from error  # fmt: skip


def _coded(value: Any) -> Any:
    if isinstance(value, bytes):
        return {"hex": value.hex()}
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": repr(value)}
    return value


def _decoded(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return bytes.fromhex(value["hex"]) if "hex" in value else float(value["float"])
