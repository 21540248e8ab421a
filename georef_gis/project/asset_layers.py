"""Layers of ``assets.gpkg`` as they stand, read by who shows them; `measure.assets` keeps them."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.errors import InputError
from georef_gis.project import geopackage
from georef_gis.project.geometry import from_blob, geometry_type

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

ASSETS_FILE = "assets.gpkg"
ASSET_LAYERS = ("asset_points", "asset_lines", "asset_polygons")
ELLIPSE_LAYER = "asset_ellipses"
_GEOMETRIES = {
    "asset_points": "Point", "asset_lines": "LineString", "asset_polygons": "Polygon",
    ELLIPSE_LAYER: "Polygon",
}  # fmt: skip
# What goes with a place, and no longer holds once that was moved
_ACCURACY = ("sigma_e", "sigma_n", "sigma_u", "corr_en", "semi_major", "semi_minor", "azimuth",
             "conf", "dof", "n_rays", "photo_ids", "pixels")  # fmt: skip
_GEOM_KEY = '"geom": {"hex": "'
# s
_WAIT = 5.0
# Rows that are read at once
_BATCH = 5000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AssetTable:
    """Features of one layer.

    Parameters
    ----------
    columns
        Name -> values of all columns but the geometry, shape (n,): float64 with NaN where empty,
        or objects as SQLite gives them where a column has anything but reals. Those of the
        accuracy are empty where they do not hold.
    offsets : shape (n + 1,)
        Vertices of feature i are ``offsets[i]:offsets[i + 1]``; none if it has no geometry of the
        layer's kind.
    xy : shape (v, 2)
        Vertices in CRS units; a ring is closed.
    height : shape (v,)
        Their heights above the ellipsoid in m, NaN where not known.
    holes : shape (n,)
        Inner rings of each area, which the vertices lack.
    """

    layer: str
    columns: Mapping[str, NDArray[Any]]
    offsets: NDArray[np.int64]
    xy: NDArray[np.float64]
    height: NDArray[np.float64]
    holes: NDArray[np.int64]

    def __len__(self) -> int:
        """Number of features."""
        return len(self.offsets) - 1

    def names(self, which: NDArray[np.bool_]) -> list[str]:
        """Names of some features, else their ids."""
        import numpy as np

        at = np.flatnonzero(which)
        columns = [self.columns[c][at] for c in ("name", "asset_id") if c in self.columns]
        return [
            next((str(value) for value in row if value not in (None, "")), "?")
            for row in zip(*columns, strict=True)
        ]


def read_asset_tables(path: Path, crs_wkt: str) -> tuple[AssetTable, ...]:
    """Layers of assets, then that of their ellipses; none without a file.

    Accuracy of a feature that another program moved since is left out: it was that of another
    place.

    Parameters
    ----------
    crs_wkt
        Project CRS.

    Raises
    ------
    InputError
        If the file cannot be read, or is in another CRS.
    """
    if not path.is_file():
        return ()
    with _reading(path) as connection:
        names = geopackage.table_names(connection)
        if ASSET_LAYERS[0] not in names or "gpkg_geometry_columns" not in names:
            return ()
        _check_crs(connection, crs_wkt, path)
        known = _known_places(connection) if "asset_known" in names else {}
        moved: set[Any] = set()
        return tuple(
            _read_table(connection, layer, known, moved)
            for layer in (*ASSET_LAYERS, ELLIPSE_LAYER)
            if layer in names
        )


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    uri = f"{path.absolute().as_uri()}?mode=ro"
    try:
        with contextlib.closing(sqlite3.connect(uri, uri=True, timeout=_WAIT)) as connection:
            # one state of the file for all its tables
            connection.execute("BEGIN")
            yield connection
    except sqlite3.Error as error:
        cure = "save or end the editing in the program that has it open, such as QGIS"
        raise InputError(f"cannot be read ({error}); {cure}", source=str(path)) from error


def _check_crs(connection: sqlite3.Connection, crs_wkt: str, path: Path) -> None:
    from georef_gis.geodesy.reference_systems import same_crs

    cursor = connection.execute(
        "SELECT s.* FROM gpkg_geometry_columns g JOIN gpkg_spatial_ref_sys s USING (srs_id) "
        "WHERE g.table_name = ?",
        (ASSET_LAYERS[0],),
    )
    cursor.row_factory = sqlite3.Row
    row = cursor.fetchone()
    if row is None:
        raise InputError("its layers have no CRS; state it in the GIS", source=str(path))
    names = ("definition", "definition_12_063")
    wkt = next((row[n] for n in names if row[n] not in (None, "", "undefined")), "")
    if not same_crs(str(wkt), crs_wkt):
        raise InputError(f"is in '{row['srs_name']}', which is not the project's CRS; give the "
                         "project that CRS again, or move the file away",
                         source=str(path))  # fmt: skip


# -- rows --------------------------------------------------------------------------------------


def _read_table(
    connection: sqlite3.Connection,
    layer: str,
    known: Mapping[Any, bytes | None],
    moved: set[Any],
) -> AssetTable:
    """Features of a layer; ids of moved ones go into `moved`, whose ellipses are left out."""
    import numpy as np

    cursor = connection.execute(f"SELECT * FROM {layer}")
    names = [column[0] for column in cursor.description]
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in names if name != "geom"}
    shapes = [_Shapes.of((), _GEOMETRIES[layer])]
    while rows := cursor.fetchmany(_BATCH):
        batch = dict(zip(names, zip(*rows, strict=True), strict=True))
        wkb = [_wkb(blob) for blob in batch.pop("geom", (None,) * len(rows))]
        ids = batch.get("asset_id", (None,) * len(rows))
        columns = {name: _array(values) for name, values in batch.items()}
        if layer == ELLIPSE_LAYER:
            keep = np.array([one not in moved for one in ids], dtype=bool)
            columns = {name: values[keep] for name, values in columns.items()}
            wkb = [one for one, kept in zip(wkb, keep.tolist(), strict=True) if kept]
        else:
            _drop_accuracy(columns, ids, wkb, known, moved)
        for name, values in columns.items():
            parts[name].append(values)
        shapes.append(_Shapes.of(wkb, _GEOMETRIES[layer]))
    counts = np.concatenate([one.counts for one in shapes])
    return AssetTable(
        layer=layer,
        columns={name: _joined(parts.pop(name)) for name in list(parts)},
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        xy=np.vstack([one.xy for one in shapes]),
        height=_heights(shapes),
        holes=np.concatenate([one.holes for one in shapes]),
    )


def _wkb(blob: Any) -> bytes | None:
    is_blob = isinstance(blob, bytes) and len(blob) > 8 and blob[:2] == b"GP"
    return from_blob(blob) if is_blob else None


def _array(values: Sequence[Any]) -> NDArray[Any]:
    """Reals as an array of them, anything else as it is."""
    import numpy as np

    if set(map(type, values)) <= {float, type(None)}:
        return np.array(values, dtype=np.float64)
    # equal texts are kept once: a class, a method, a time of storing
    seen: dict[Any, Any] = {}
    out = np.empty(len(values), dtype=object)
    out[:] = [seen.setdefault(v, v) if type(v) is str else v for v in values]
    return out


def _joined(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    import numpy as np

    if not arrays:
        return np.zeros(0)
    if len({array.dtype for array in arrays}) == 1:
        return np.concatenate(arrays)
    # a batch of empty cells alone is taken for reals
    return np.concatenate([
        array if array.dtype == object else _objects(array)
        for array in arrays
    ])  # fmt: skip


def _objects(reals: NDArray[Any]) -> NDArray[Any]:
    out = reals.astype(object)
    # NaN is not itself
    out[reals != reals] = None
    return out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Shapes:
    """Some geometries: vertices of each (none of other kinds), inner rings; all vertices."""

    counts: NDArray[np.int64]
    holes: NDArray[np.int64]
    xy: NDArray[np.float64]
    height: NDArray[np.float64]

    @classmethod
    def of(cls, wkb: Sequence[bytes | None], kind: str) -> _Shapes:
        """Geometries of a kind."""
        import numpy as np
        import shapely

        code = getattr(shapely.GeometryType, kind.upper())
        shapes = shapely.from_wkb(np.array(wkb, dtype=object), on_invalid="ignore")
        single = (shapely.get_type_id(shapes) == code + 4 - (code > 2)) & (
            shapely.get_num_geometries(shapes) == 1
        )
        shapes[single] = shapely.get_geometry(shapes[single], 0)
        usable = (shapely.get_type_id(shapes) == code) & ~shapely.is_empty(shapes)
        shapes[~usable] = None
        holes = np.zeros(len(shapes), np.int64)
        if kind == "Polygon":
            holes[usable] = shapely.get_num_interior_rings(shapes[usable])
            shapes = shapely.get_exterior_ring(shapes)
        points, index = shapely.get_coordinates(
            shapes, include_z=bool(shapely.has_z(shapes).any()), return_index=True
        )
        bad = np.unique(index[~np.isfinite(points[:, :2]).all(axis=1)])
        if len(bad):
            good = ~np.isin(index, bad)
            points, index = points[good], index[good]
        return cls(
            counts=np.bincount(index, minlength=len(shapes)),
            holes=holes,
            xy=points[:, :2].copy(),
            height=points[:, 2].copy() if points.shape[1] > 2 else _no_heights(len(points)),
        )


def _no_heights(count: int) -> NDArray[np.float64]:
    """Heights that are not known, which take no memory."""
    import numpy as np

    return np.broadcast_to(np.float64(np.nan), (count,))


def _heights(shapes: Sequence[_Shapes]) -> NDArray[np.float64]:
    import numpy as np

    if all(one.height.strides == (0,) for one in shapes if len(one.height)):
        return _no_heights(sum(len(one.height) for one in shapes))
    return np.concatenate([one.height for one in shapes])


# -- what another program moved ------------------------------------------------------------------


def _known_places(connection: sqlite3.Connection) -> dict[Any, bytes | None]:
    """Geometry of each asset as it was when its accuracy was stated."""
    out: dict[Any, bytes | None] = {}
    for asset_id, content in connection.execute("SELECT asset_id, content FROM asset_known"):
        with contextlib.suppress(AttributeError, KeyError, TypeError, ValueError):
            # as the store writes it, where quotes within texts are escaped: 10 times as fast
            _, key, rest = content.partition(_GEOM_KEY)
            text = rest.partition('"')[0] if key else json.loads(content)["geom"]["hex"]
            out[asset_id] = bytes.fromhex(text)
    return out


def same_place(first: bytes | None, second: bytes | None) -> bool:
    """Whether two geometries are one up to rounding; another program may write one anew."""
    import numpy as np
    import shapely

    if first == second or first is None or second is None:
        return first == second
    if geometry_type(first)[0] != geometry_type(second)[0]:
        return False
    try:
        a, b = (shapely.get_coordinates(shapely.from_wkb(wkb)) for wkb in (first, second))
    except shapely.errors.GEOSException:
        return False
    # CRS units: far below a click, far above the rounding of a double
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=0.0, atol=1e-6))


def _drop_accuracy(
    columns: dict[str, NDArray[Any]],
    ids: Sequence[Any],
    wkb: Sequence[bytes | None],
    known: Mapping[Any, bytes | None],
    moved: set[Any],
) -> None:
    """Empty the columns of the accuracy of features that were moved; enter their ids."""
    import numpy as np

    gone = np.array([not same_place(w, known.get(i)) for i, w in zip(ids, wkb, strict=True)])
    if not gone.any():
        return
    moved.update(one for one, is_gone in zip(ids, gone.tolist(), strict=True) if is_gone)
    for name in _ACCURACY:
        if name in columns:
            is_real = columns[name].dtype != object
            columns[name][gone] = np.nan if is_real else None
    method = columns.get("method", np.full(len(ids), None)).astype(object)
    columns["method"] = np.where(gone, "edited", method)
