"""What metadata say of a product: gathered from the project once, for any standard."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exports.metadata.checksums import checksum
from exports.metadata.products import Product, number_of, start_of, steps_before, tool_id
from exports.site.accuracy import STATEMENT, main_assessment, read_statement
from exports.site.reader import read_accuracy
from exports.tables.geojson_features import bounds_of
from georef_gis.errors import CrsError
from georef_gis.geodesy import CRS, parse_crs, same_crs
from georef_gis.units import utc_from_gps

if TYPE_CHECKING:
    from exports.site.site import SiteLayers
    from georef_gis.project import Project

Box = tuple[float, float, float, float]
# Longest text of parameters and of results of a step, and what of those is told elsewhere
_MOST_LETTERS = 800
_NOT_FIGURES = ("products", "outputs", "doubts", "statement")
# m, to which the formats of features write places (docs/formats.md)
_VERTEX_STEP = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class Tested:
    """An accuracy that was tested at check points.

    Parameters
    ----------
    component
        ``H`` (radial horizontal), ``V`` or ``3D``.
    rmse : m
        With the share of the survey.
    accuracy_class : m
        Of the standard; `declared` before the test or derived from it.
    meets
        Whether the declared class is met; None = not declared.
    """

    component: str
    rmse: float
    points: int
    accuracy_class: float
    declared: bool
    meets: bool | None
    vegetated: bool
    statement: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """Errors along an axis of the map at check points: mean, standard deviation, RMSE, m."""

    mean: float
    sd: float
    rmse: float
    points: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Accuracy:
    """The accuracy statement of the products, with its numbers.

    Parameters
    ----------
    statements
        As the standard words them, also where nothing was tested.
    axes
        By ``x``, ``y``, ``z``.
    measured_on
        On what product the errors were measured.
    """

    standard: str
    statements: tuple[str, ...]
    tested: tuple[Tested, ...]
    axes: Mapping[str, Axis]
    measured_on: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Raster:
    """Grid of a raster: CRS, columns and rows, pixel in CRS units and in m, box in degrees."""

    crs: CRS
    size: tuple[int, int]
    pixel: float
    unit: str
    gsd: float | None
    box: Box | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of the lineage."""

    text: str
    when: datetime


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductFacts:
    """All that is said of one product; None and empty are unknown.

    Parameters
    ----------
    box
        West, south, east, north, deg; west > east across the antimeridian.
    spacing : m
        Nominal distance of neighbouring coordinates: the GSD, of tiles and folders that of the
        step they are made from, of vertices what they are rounded to.
    expected : m
        One sigma per horizontal axis that the poses promise.
    doubts
        Why what is said may not hold.
    """

    site: SiteFacts
    product: Product
    size: int
    checksum: str
    checksum_of: str
    crs_name: str
    crs_code: str
    crs_wkt: str
    height_kind: str
    box: Box | None
    gsd: float | None
    spacing: float | None
    grid: tuple[int, int] | None
    expected: float | None
    accuracy: Accuracy | None
    steps: tuple[Step, ...]
    doubts: tuple[str, ...]

    @property
    def title(self) -> str:
        """Site and file."""
        return f"{self.site.layers.name}: {self.product.path.name}"


@dataclass(frozen=True, kw_only=True, eq=False)
class SiteFacts:
    """What all products of a site share."""

    project: Project
    layers: SiteLayers
    runs: Sequence[Mapping[str, Any]] = field(default=())

    @classmethod
    def of(cls, project: Project, layers: SiteLayers) -> SiteFacts:
        """Facts of a project whose layers are read already."""
        return cls(project=project, layers=layers, runs=tuple(project.database.rows("run")))

    @cached_property
    def flown(self) -> tuple[datetime, datetime] | None:
        """First and last time of exposure, UTC; None if no photo's is known."""
        times = [p.photo.time_gps for p in self.layers.photos if p.photo.time_gps is not None]
        if not times:
            return None
        epoch = self.layers.epoch_gps
        return utc_from_gps(epoch + min(times)), utc_from_gps(epoch + max(times))

    @cached_property
    def timed(self) -> int:
        """Number of photos with a known time."""
        return sum(p.photo.time_gps is not None for p in self.layers.photos)

    @cached_property
    def box(self) -> Box | None:
        """Box of footprints and photos, deg."""
        layers = self.layers.layers
        places = [layers[name].places.lonlat for name in ("footprints", "photos")]
        return _box(bounds_of([one for one in places if len(one)]))

    @cached_property
    def accuracy(self) -> Accuracy | None:
        """Statement of the products as they are now; None if there is none of these."""
        items, _ = read_accuracy(self.project)
        path = self.project.products / STATEMENT
        return read_statement(path, _accuracy) if items else None

    def product(self, product: Product) -> ProductFacts:
        """All that is said of one product."""
        raster = _raster(self.layers, product.path) if _is_raster(product.path) else None
        digest, meant, size = checksum(product.path)
        crs, code = self._crs(product, raster)
        steps = steps_before(self.runs, product)
        gsd = _gsd(product, raster)
        return ProductFacts(
            site=self, product=product, size=size, checksum=digest, checksum_of=meant,
            crs_name=str(crs.name) if crs is not None else "", crs_code=code,
            crs_wkt=crs.to_wkt() if crs is not None else "",
            height_kind=str(product.summary.get("height_kind") or ""),
            box=self.box if raster is None or raster.box is None else raster.box,
            gsd=gsd, spacing=_spacing(product, gsd, steps), grid=raster.size if raster else None,
            expected=None if product.older_than else _expected(steps),
            accuracy=None if product.older_than else self.accuracy,
            steps=tuple(_step(run) for run in steps), doubts=_doubts(product),
        )  # fmt: skip

    def _crs(self, product: Product, raster: Raster | None) -> tuple[CRS | None, str]:
        """CRS of a product and its code, empty if it has none."""
        ours = self.layers.crs
        if raster is not None:
            crs = ours if same_crs(raster.crs.to_wkt(), ours.to_wkt()) else raster.crs
        else:
            told = str(product.summary.get("crs") or "")
            if not told or told in (self.layers.crs_name, str(ours.name)):
                crs = ours
            else:
                try:
                    crs = parse_crs(told)
                except CrsError:
                    return None, ""
        code = crs.to_authority(min_confidence=100)
        return crs, ":".join(code) if code else ""


# -- rasters -----------------------------------------------------------------------------------


def _is_raster(path: Path) -> bool:
    return path.suffix.lower() in (".tif", ".tiff")


def _raster(site: SiteLayers, path: Path) -> Raster | None:
    """Grid of a file; None if GDAL cannot read it or it has no CRS."""
    import rasterio
    from rasterio.errors import RasterioError

    try:
        with rasterio.open(path) as file:
            if file.crs is None:
                return None
            wkt, size, bounds = file.crs.to_wkt(), (file.width, file.height), file.bounds
            pixel = float(abs(file.transform.a))
        crs = parse_crs(wkt)
    except (RasterioError, CrsError):
        return None
    axis = crs.axis_info[0]
    mapped = crs.is_projected
    return Raster(
        crs=crs, size=size, pixel=pixel, unit=str(axis.unit_name),
        gsd=pixel * float(axis.unit_conversion_factor) if mapped else None,
        box=_geographic(site, bounds) if same_crs(wkt, site.crs.to_wkt()) else None,
    )  # fmt: skip


def _geographic(site: SiteLayers, bounds: Sequence[float]) -> Box | None:
    """Box in degrees of one on the map, whose sides are bent there."""
    west, south, east, north = bounds
    t = np.linspace(0.0, 1.0, 9)
    x, y = west + t * (east - west), south + t * (north - south)
    sides = [(x, np.full(9, south)), (x, np.full(9, north)),
             (np.full(9, west), y), (np.full(9, east), y)]  # fmt: skip
    p_map = np.vstack([np.column_stack([*side, np.zeros(9)]) for side in sides])
    geo = np.degrees(site.frame.geo_from_map(p_map)[:, 1::-1])
    return _box(bounds_of([geo])) if np.all(np.isfinite(geo)) else None


def _box(sides: Sequence[float]) -> Box | None:
    return (sides[0], sides[1], sides[2], sides[3]) if len(sides) == 4 else None


def _gsd(product: Product, raster: Raster | None) -> float | None:
    """Ground sample distance, m."""
    if raster is not None and raster.gsd is not None:
        return raster.gsd
    return number_of(product.summary, "gsd_m")


def _spacing(
    product: Product, gsd: float | None, steps: Sequence[Mapping[str, Any]]
) -> float | None:
    """Nominal distance of neighbouring coordinates, m; None if there is no telling."""
    if gsd is not None:
        return gsd
    if product.representation != "grid":
        return _VERTEX_STEP
    found = (number_of(r["summary"], "gsd_m") for r in reversed(steps) if r["summary"])
    return next((length for length in found if length), None)


# -- lineage and accuracy ----------------------------------------------------------------------


def _step(run: Mapping[str, Any]) -> Step:
    versions = run["versions"] or {}
    told = ", ".join(f"{name} {version}" for name, version in sorted(versions.items()))
    parts = [f"{run['tool']} ({told})", f"parameters {_short(run['parameters'] or {})}"]
    summary = run["summary"]
    if isinstance(summary, Mapping):
        plain = {k: v for k, v in summary.items() if k not in _NOT_FIGURES}
        parts.append(f"result {_short(plain)}")
    parts += [f"warning: {line}" for line in (run["warnings"] or ())[:5]]
    return Step(text="; ".join(parts), when=start_of(run))


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= _MOST_LETTERS else f"{text[:_MOST_LETTERS]} ... (cut)"


def _expected(steps: Sequence[Mapping[str, Any]]) -> float | None:
    """Expected sigma of a photo's place, which the footprints tell."""
    for run in reversed(steps):
        if tool_id(run) == "footprints" and isinstance(run["summary"], Mapping):
            return number_of(run["summary"], "sigma_horizontal_m")
    return None


def _doubts(product: Product) -> tuple[str, ...]:
    out: tuple[str, ...] = ()
    if product.older_than:
        out += (
            f"made before the {product.older_than} of the project were made anew: what was found "
            "of the accuracy since then is not of this product",
        )
    if product.changed:
        out += ("changed by another program after it was made: the lineage does not tell how",)
    return out


def _accuracy(data: Mapping[str, Any]) -> Accuracy:
    """Statement of the tool `accuracy`."""
    main = main_assessment(data)
    on = main.get("measured_on") or {}
    return Accuracy(
        standard=str(data["standard"]),
        statements=tuple(str(line) for line in data["statement"]),
        tested=tuple(_tested(c) for c in main["components"] if c["n"] and "statement" in c),
        axes={
            name: Axis(mean=a["mean"], sd=a["sd"], rmse=a["rmse"], points=a["n"])
            for name, a in main["axes"].items()
            if a["n"]
        },
        measured_on=", ".join(f"{what}: {text}" for what, text in on.items()),
    )


def _tested(c: Mapping[str, Any]) -> Tested:
    return Tested(
        component=str(c["name"]), rmse=float(c["rmse"]), points=int(c["n"]),
        accuracy_class=float(c["class_m"]), declared=bool(c["class_declared"]),
        meets=c["meets"], vegetated=bool(c["vegetated"]), statement=str(c["statement"]),
    )  # fmt: skip
