"""What the vector formats that GDAL writes share: geometries as WKB, one table, its errors."""

from __future__ import annotations

import errno
import os
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.errors import ExportError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from exports.site.columns import Column, Layer
    from exports.site.site import SiteLayers
Heights = Literal["attributes", "ellipsoidal", "orthometric"]


def geometries(layer: Layer, heights: Heights) -> tuple[NDArray[np.object_] | None, str | None]:
    """WKB and type of a layer's geometries: 3D only where every vertex has such a height."""
    import numpy as np

    if layer.geometry == "None":
        return None, None
    kind = geometry_type(layer, heights)
    return np.concatenate(list(wkb_batches(layer, heights))), kind


def geometry_type(layer: Layer, heights: Heights) -> str:
    """Type of a layer's geometries, such as ``Point Z``."""
    flat = heights == "attributes" or not layer.solid.all()
    return layer.geometry if flat else f"{layer.geometry} Z"


def flat_warnings(layers: Sequence[Layer], heights: Heights) -> list[str]:
    """Which layers stay 2D although heights are asked for, and why."""
    if heights == "attributes":
        return []
    left = [
        f"{layer.name} ({int((~layer.solid).sum())} of {len(layer)})"
        for layer in layers
        if layer.geometry != "None" and not layer.solid.all()
    ]
    if not left:
        return []
    return [
        "layers that stay 2D, as features of theirs have no measured height at every vertex: "
        + ", ".join(left)
    ]


def wkb_batches(layer: Layer, heights: Heights) -> Iterator[NDArray[np.object_]]:
    """Little-endian ISO WKB of the features, some thousand at a time."""
    import numpy as np
    import shapely

    at = layer.places
    flat = geometry_type(layer, heights) == layer.geometry
    z = at.height if flat or heights == "ellipsoidal" else at.height_orthometric
    for start, stop in layer.batches():
        rows = slice(at.offsets[start], at.offsets[stop])
        part = at.xy[rows] if flat else np.column_stack([at.xy[rows], z[rows]])
        index = np.repeat(np.arange(stop - start), np.diff(at.offsets[start : stop + 1]))
        if layer.geometry == "Point":
            shapes = shapely.points(part)
        elif layer.geometry == "LineString":
            shapes = shapely.linestrings(part, indices=index)
        else:
            shapes = shapely.polygons(shapely.linearrings(part, indices=index))
        yield shapely.to_wkb(shapes, flavor="iso", byte_order=1)


def crs_text(site: SiteLayers) -> str:
    """Code of the project's horizontal CRS, else its WKT."""
    authority = site.crs.to_authority(min_confidence=100)
    return ":".join(authority) if authority else str(site.crs.to_wkt())


def write_table(
    target: Path,
    names: Sequence[str],
    columns: Sequence[Column],
    wkb: NDArray[np.object_] | None,
    **how: Any,
) -> None:
    """Write one table by GDAL.

    Parameters
    ----------
    names
        Of the columns in the file.
    wkb
        Geometries; None for a table without.
    how
        `driver`, `crs`, `geometry_type`, `layer` and other words of ``pyogrio.raw.write``.

    Raises
    ------
    OSError
        If it cannot be written; the toolbox says what to do.
    ExportError
        If a field cannot hold a value, which GDAL would leave out.
    """
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, GeometryError

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            pyogrio.raw.write(
                target,
                geometry=wkb,
                field_data=[column.values for column in columns],
                field_mask=[column.missing for column in columns],
                fields=list(names),
                **how,
            )
        except (
            DataSourceError, DataLayerError, FeatureError, GeometryError, RuntimeError
        ) as error:  # fmt: skip
            raise refusal(error, target) from error
    _check_told(told, str(how.get("layer", target.stem)))


def _check_told(told: Sequence[warnings.WarningMessage], layer: str) -> None:
    """Refuse a value that GDAL left out, and pass other warnings on.

    They come out of a callback, in which an error would be lost.
    """
    for one in told:
        what, left_out, _ = str(one.message).partition(" not successfully written")
        if left_out:
            raise ExportError(
                f"{layer}: {what} is larger than the format holds; correct it in a GIS, or export "
                "GeoPackage"
            )
        warnings.warn(one.message, one.category, stacklevel=3)


def refusal(error: Exception, target: Path) -> OSError:
    """Error of the system's kind for one of a library."""
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    full = "full" in text or "No space" in text
    return OSError(errno.ENOSPC if full else errno.EIO, text, os.fspath(target))


def unplaced_warning(site: SiteLayers) -> tuple[str, ...]:
    """What to say of photos that have no place."""
    if not site.unplaced:
        return ()
    left = ", ".join(site.unplaced[:5])
    return (f"photos left out, as they have no position: {left}",)
