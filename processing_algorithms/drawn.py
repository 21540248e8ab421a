"""Areas and lines that users draw: from a vector file of any CRS, or from corners as given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.errors import CrsError, InputError
from georef_gis.frames import Array

if TYPE_CHECKING:
    from georef_gis.geodesy import CRS
    from georef_gis.toolbox.values import MapPoint

Kind = Literal["area", "line"]
_TYPES = {"area": "Polygon", "line": "LineString"}
# columns of a layer that name a shape, in this order
_NAMES = ("name", "Name", "NAME", "id", "ID")
# deg; a side drawn between degrees is curved on a map, 2 cm in so much
_STRAIGHT_DEG = 0.005
_CURE = "give GeoJSON, GeoPackage, Shapefile or KML"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawn:
    """One polygon or line in the CRS that was asked for (shapely), and what it is called."""

    name: str
    shape: Any

    @property
    def vertices(self) -> Array:
        """Places of the line, or of the outer rim without its end; (n, 2)."""
        import numpy as np
        import shapely

        if self.shape.geom_type == "Polygon":
            return np.asarray(shapely.get_coordinates(self.shape.exterior)[:-1])
        return np.asarray(shapely.get_coordinates(self.shape))


def drawn(
    kind: Kind,
    file: str | None,
    corners: Sequence[MapPoint],
    crs: CRS,
    *,
    layer: str | None = None,
) -> list[Drawn]:
    """Shapes of a file, or the one that corners make.

    Parameters
    ----------
    file
        Or one of its layers, ``file|layername=name``, for which `layer` is another spelling.
    crs
        Wanted; a horizontal one. That of corners which name none.

    Raises
    ------
    InputError
        If both or neither are given, the file holds no such shape, or two layers are named.
    CrsError
        If a CRS is unknown, or the shape lies where the wanted one does not hold.
    """
    what = {"area": "an area", "line": "a line"}[kind]
    if (file is None) == (not corners):
        raise InputError(f"give {what} by a file or by its corners, not both", field=kind)
    if file is not None:
        path, named = layer_file(file, layer, field=kind)
        return _of_file(kind, path, named, crs)
    return [Drawn(name=kind, shape=_of_corners(kind, corners, crs))]


def layer_file(given: str, layer: str | None, *, field: str) -> tuple[Path, str | None]:
    """File of a layer as given, and the name of the layer if one is told there or beside it.

    Raises
    ------
    InputError
        If it is told twice and not the same, or the text asks for more than a layer.
    """
    from georef_gis.toolbox.values import LayerFile

    try:
        one = LayerFile.parse(given)
    except ValueError as error:
        raise InputError(str(error), field=field) from error
    if layer is not None and one.layer not in (None, layer):
        raise InputError(
            f"{given} names the layer '{one.layer}' and --layer '{layer}'; leave out one of them",
            field="layer",
        )
    return one.path, layer or one.layer


# -- corners -----------------------------------------------------------------------------------


def _of_corners(kind: Kind, corners: Sequence[MapPoint], crs: CRS) -> Any:
    import numpy as np
    import shapely

    from georef_gis.geodesy import horizontal_crs, parse_crs

    least = 3 if kind == "area" else 2
    if len(corners) < least:
        raise InputError(
            f"{len(corners)} corners are given, {least} or more are needed", field="corner"
        )
    places = []
    for corner in corners:
        own = horizontal_crs(parse_crs(corner.crs)) if corner.crs else crs
        if not own.is_projected and (abs(corner.x) > 360.0 or abs(corner.y) > 90.0):
            raise InputError(
                f"{corner.x:g},{corner.y:g} is no longitude and latitude, deg; write "
                "x,y@CRS for places of a map",
                field="corner",
            )
        places.append(_moved(np.array([[corner.x, corner.y]]), own, crs, "corner")[0])
    xy = np.array(places)
    return _sound(shapely.Polygon(xy) if kind == "area" else shapely.LineString(xy), "corner")


def _moved(xy: Array, source: CRS, target: CRS, name: str) -> Array:
    import numpy as np

    from georef_gis.geodesy.reference_systems import transformer_between

    if source.equals(target, ignore_axis_order=True):
        return xy
    out = np.column_stack(transformer_between(source, target).transform(xy[:, 0], xy[:, 1]))
    if not np.isfinite(out).all():
        raise CrsError(
            f"does not lie where '{target.name}' holds; check its CRS and the order x,y",
            source=name,
        )
    return np.asarray(out)


def _sound(shape: Any, source: str) -> Any:
    import shapely

    if shape.geom_type == "Polygon" and not (shapely.is_valid(shape) and shape.area > 0):
        why = shapely.is_valid_reason(shape)
        raise InputError(f"encloses no area ({why}); draw its corners in order", source=source)
    if shape.geom_type == "LineString" and not shape.length > 0:
        raise InputError("has no length; give places that differ", source=source)
    return shape


# -- files -------------------------------------------------------------------------------------


def _of_file(kind: Kind, path: Path, layer: str | None, crs: CRS) -> list[Drawn]:
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError

    if not path.is_file():
        raise InputError("there is no such file", source=str(path), field=kind)
    try:
        found = _layers(kind, path, layer)
    except (DataSourceError, DataLayerError, FeatureError, RuntimeError) as error:
        told = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"cannot be read ({told}); {_CURE}", source=str(path)) from error
    if not found:
        raise InputError(f"holds no {_TYPES[kind].lower()}; {_CURE}", source=str(path))
    if len(found) > 1:
        raise InputError(
            f"has {kind}s in {len(found)} layers ({', '.join(sorted(found))}); say which "
            "by --layer",
            source=str(path),
        )
    shapes, stated = next(iter(found.values()))
    return [_on_map(one, stated, crs, path) for one in shapes]


def _layers(kind: Kind, path: Path, layer: str | None) -> dict[str, tuple[list[Drawn], str | None]]:
    """Shapes of that kind by layer, and the CRS of each."""
    import pyogrio

    names = [str(name) for name, _ in pyogrio.list_layers(path)]
    if layer is not None and layer not in names:
        raise InputError(
            f"has no layer '{layer}'; use {', '.join(sorted(names)) or 'another file'}",
            source=str(path), field="layer",
        )  # fmt: skip
    read = {name: _shapes(kind, path, name) for name in ([layer] if layer else names)}
    return {name: content for name, content in read.items() if content[0]}


def _shapes(kind: Kind, path: Path, layer: str) -> tuple[list[Drawn], str | None]:
    import numpy as np
    import pyogrio
    import shapely

    columns = [str(name) for name in pyogrio.read_info(path, layer=layer)["fields"]]
    named = next((name for name in _NAMES if name in columns), None)
    meta, _, blobs, values = pyogrio.raw.read(
        path, layer=layer, columns=[named] if named else [], force_2d=True
    )
    out: list[Drawn] = []
    for k, blob in enumerate(blobs if blobs is not None else ()):
        with np.errstate(invalid="ignore"):
            # not a number: refused below
            shape = None if blob is None else shapely.from_wkb(blob, on_invalid="ignore")
        parts = [] if shape is None else shapely.get_parts(shape)
        mine = [part for part in parts if part.geom_type == _TYPES[kind] and not part.is_empty]
        title = str(values[0][k]) if named and values[0][k] is not None else str(k + 1)
        for number, part in enumerate(mine, start=1):
            name = title if len(mine) == 1 else f"{title}.{number}"
            out.append(Drawn(name=name, shape=_sound(part, f"{path}: {name}")))
    return out, meta["crs"]


def _on_map(one: Drawn, stated: str | None, target: CRS, path: Path) -> Drawn:
    import shapely

    from georef_gis.geodesy import horizontal_crs, parse_crs

    if not stated:
        raise CrsError(
            "has no CRS; state it (a .prj file, or Set Layer CRS in a GIS)", source=str(path)
        )
    source = horizontal_crs(parse_crs(stated))
    shape = one.shape
    if not source.is_projected and target.is_projected:
        shape = shapely.segmentize(shape, _STRAIGHT_DEG)
    moved = shapely.transform(shape, lambda xy: _moved(xy, source, target, str(path)))
    return Drawn(name=one.name, shape=moved)
