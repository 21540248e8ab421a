"""Tool `volume`: cut and fill of stockpiles and trenches against a base, with their sigma."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame
    from georef_gis.measure.surface.base import MakeBase
    from georef_gis.measure.surface.field import HeightField
    from georef_gis.measure.surface.volume import Volume
    from georef_gis.project import Project

# times the size of an area around it from which points are taken
AROUND = 3.0


class VolumeParameters(p.Parameters):
    """Parameters of `volume`."""

    area: p.VectorLayer | None = p.vector_layer(
        None, title="File with the areas; every polygon is measured"
    )
    layer: p.Text | None = p.text(None, title="Layer of that file, if several have polygons")
    corner: tuple[p.MapPoint, ...] = p.map_point(
        (), title="Corner of one area, x,y of the map (or @CRS); give it once per corner"
    )
    base: Literal["rim", "lowest", "height", "surface"] = p.choice(
        "rim", title="Base",
        help="rim: plane through the rim, robust; lowest: level of its lowest stretch; height: a "
        "level that you give; surface: another raster of heights, such as that of an earlier "
        "flight",
    )  # fmt: skip
    height: p.Length | None = p.length(None, title="Height of that level", unit="m")
    height_kind: Literal["orthometric", "ellipsoidal"] = p.choice(
        "orthometric", title="What that height is above: geoid of [gnss] geoid, or ellipsoid"
    )
    height_sigma: p.Length = p.length(0.0, title="One sigma of that height", ge=0)
    base_raster: p.RasterLayer | None = p.raster_layer(None, title="Raster of the other surface")
    base_sigma: p.Length | None = p.length(
        None, title="One sigma of that raster's heights", gt=0, advanced=True
    )
    of: Literal["auto", "points", "ground"] = p.choice(
        "auto", title="Surface",
        help="points: adjusted points, flat triangles between them; ground: what the photos are "
        "laid on, smooth; auto: the points where there are some and no DEM is given",
    )  # fmt: skip
    raster: p.RasterLayer | None = p.raster_layer(
        None, title="Raster of heights, instead of the project's own"
    )
    sigma: p.Length | None = p.length(
        None, title="One sigma of that raster's heights", gt=0, advanced=True
    )
    target: p.File | None = p.file(
        None,
        title="CSV to write; by default products/volumes.csv",
        suffixes=(".csv", ".json"),
        writes=True,
    )


class VolumeTool(Algorithm[VolumeParameters]):
    """Volumes above and below a base inside areas, such as stockpiles and trenches.

    Above is to cut, below is to fill. A shift of all heights cancels against a base that rests on
    the same surface, their tilt against the rim; what is left is told by source. Draw the area
    outside of the toe.
    """

    id, name, group = "volume", "Volume over a base", "measure"
    about = "areas"
    needs = ("poses",)
    wants = ("adjusted",)
    uses_quick = True
    outputs = (Output(name="volumes", title="Volumes as CSV"),)

    def run(self, context: Context, parameters: VolumeParameters, feedback: Feedback) -> Result:
        """Measure them."""
        import shapely

        from georef_gis.measure.surface.volume import volume
        from georef_gis.project.records import load_frame
        from processing_algorithms.drawn import drawn
        from processing_algorithms.measure.point_table import write_rows
        from processing_algorithms.surface.source import chosen_field, on_plane

        project = context.require_project()
        frame = load_frame(project.database)
        areas = drawn("area", parameters.area, parameters.corner, frame.horizontal,
                      layer=parameters.layer)  # fmt: skip
        around = shapely.union_all([one.shape for one in areas])
        field = chosen_field(
            project, frame, parameters.of, parameters.raster, around, sigma=parameters.sigma,
            quick=context.quick,
        )  # fmt: skip
        rows: list[dict[str, Any]] = []
        doubts: list[str] = []
        for number, one in enumerate(areas):
            check_cancelled(feedback)
            feedback.progress(number / len(areas), one.name)
            area = on_plane(frame, one.shape, field)
            make = _base(project, frame, parameters, area)
            found = volume(_near(field, area), area, make)
            rows.append(_row(one.name, found))
            doubts += [f"{one.name}: {line}" for line in found.doubts]
        for line in doubts:
            feedback.warn(line)
        target = parameters.target or _default(project)
        write_rows(target, rows, list(rows[0]))
        summary = {"products": [str(target)], "of": field.name, "volumes": rows, "doubts": doubts}
        return Result(outputs={"volumes": target}, summary=summary)


def _default(project: Project) -> Path:
    project.products.mkdir(parents=True, exist_ok=True)
    return project.products / "volumes.csv"


def _near(field: HeightField, area: Any) -> HeightField:
    """The part of a surface of points about an area: a block has a million of them."""
    import numpy as np
    import shapely

    from georef_gis.measure.surface.points import PointField

    if not isinstance(field, PointField):
        return field
    x0, y0, x1, y1 = shapely.bounds(area)
    middle = np.array([(x0 + x1) / 2.0, (y0 + y1) / 2.0])
    return field.near(middle, AROUND * max(x1 - x0, y1 - y0) + 4.0 * field.spacing)


def _base(project: Project, frame: MapFrame, parameters: VolumeParameters, area: Any) -> MakeBase:
    """What makes the base of an area, m in enu, from the parameters.

    Raises
    ------
    InputError
        If what the base needs is not given.
    """
    from georef_gis.errors import InputError
    from georef_gis.measure.surface.base import GivenHeight, LowestLevel, OtherSurface, RimPlane

    if parameters.base == "rim":
        return lambda field: RimPlane.of(field, area)
    if parameters.base == "lowest":
        return lambda field: LowestLevel.of(field, area)
    if parameters.base == "height":
        if parameters.height is None:
            raise InputError("give the height of the base with --height", field="base")
        height = _ellipsoidal(project, frame, parameters)
        level = GivenHeight(
            origin=frame.origin, height_ellipsoidal=height, sigma=parameters.height_sigma
        )
        return lambda field: level
    if parameters.base_raster is None:
        raise InputError("give the other surface with --base-raster", field="base")
    import shapely

    from processing_algorithms.surface.given import raster_field

    other = raster_field(
        project, frame, Path(parameters.base_raster), around=shapely.get_coordinates(area),
        sigma=parameters.base_sigma,
    )  # fmt: skip
    return lambda field: OtherSurface(field=other)


def _ellipsoidal(project: Project, frame: MapFrame, parameters: VolumeParameters) -> float:
    """Height of the stated level above the ellipsoid, m."""
    from georef_gis.geodesy import Height, HeightKind

    height = Height(
        value=float(parameters.height or 0.0), kind=HeightKind(parameters.height_kind),
        geoid=project.settings.gnss.geoid,
    )  # fmt: skip
    return height.ellipsoidal(frame.origin.lat, frame.origin.lon)


def _row(name: str, found: Volume) -> dict[str, Any]:
    def rounded(value: float, digits: int) -> float:
        # no "-0.0"
        return round(value, digits) + 0.0

    return {
        "name": name,
        "area_m2": round(found.area, 2),
        "above_m3": round(found.above, 2),
        "sigma_above_m3": round(found.sigma_above, 2),
        "below_m3": round(found.below, 2),
        "sigma_below_m3": round(found.sigma_below, 2),
        "net_m3": rounded(found.net, 2),
        "sigma_net_m3": round(found.sigma_net, 2),
        "mean_height_m": rounded(found.mean_height, 3),
        "highest_m": rounded(found.highest, 3),
        "lowest_m": rounded(found.lowest, 3),
        "base": found.base,
        "level_cancels": found.level_cancels,
        "sigma_parts_m3": "; ".join(f"{k} {v:.2f}" for k, v in found.parts.items() if v > 0.0),
        "doubts": "; ".join(found.doubts),
    }
