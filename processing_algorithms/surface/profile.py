"""Tool `profile`: heights of a surface along a line, with their sigma, as table and plot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.measure.surface.profile import Profile
    from georef_gis.project import Project


class ProfileParameters(p.Parameters):
    """Parameters of `profile`."""

    line: p.VectorLayer | None = p.vector_layer(
        None, title="File with the line; every line is a profile"
    )
    layer: p.Text | None = p.text(None, title="Layer of that file, if several have lines")
    corner: tuple[p.MapPoint, ...] = p.map_point(
        (), title="Vertex of the line, x,y of the map (or @CRS); give it once per vertex"
    )
    of: Literal["auto", "points", "ground"] = p.choice(
        "auto", title="Surface",
        help="points: adjusted points, flat triangles between them; ground: what the photos are "
        "laid on; auto: the points where there are some and no DEM is given",
    )  # fmt: skip
    raster: p.RasterLayer | None = p.raster_layer(
        None, title="Raster of heights, instead of the project's own"
    )
    sigma: p.Length | None = p.length(
        None, title="One sigma of that raster's heights", gt=0, advanced=True
    )
    heights: Literal["orthometric", "ellipsoidal"] = p.choice("orthometric", title="Heights")
    step: p.Length | None = p.length(None, title="Between stations, on the ground", gt=0)
    target: p.File | None = p.file(
        None,
        title="CSV to write; by default products/profile.csv",
        suffixes=(".csv", ".json"),
        writes=True,
    )


class ProfileTool(Algorithm[ProfileParameters]):
    """Heights along a line with their sigma: a table, and a plot with the band of one sigma.

    Two sigmas: of the height above the datum, and of it against its surroundings, which is what
    counts for its shape.
    """

    id, name, group = "profile", "Profile along a line", "measure"
    about = "lines"
    needs = ("poses",)
    wants = ("adjusted",)
    uses_quick = True
    outputs = (
        Output(name="profile", title="Stations as CSV"),
        Output(name="picture", title="Plot of the profile"),
    )

    def run(self, context: Context, parameters: ProfileParameters, feedback: Feedback) -> Result:
        """Measure it."""
        import shapely

        from georef_gis.measure.surface.profile import profile_along
        from georef_gis.measure.surface.raster import HeightReference
        from georef_gis.project.records import load_frame
        from processing_algorithms.drawn import drawn
        from processing_algorithms.surface.source import chosen_field

        project = context.require_project()
        frame = load_frame(project.database)
        lines = drawn("line", parameters.line, parameters.corner, frame.horizontal,
                      layer=parameters.layer)  # fmt: skip
        around = shapely.union_all([line.shape for line in lines])
        field = chosen_field(
            project, frame, parameters.of, parameters.raster, around, sigma=parameters.sigma,
            quick=context.quick,
        )  # fmt: skip
        reference = HeightReference.promised(
            parameters.heights, project.settings.gnss.geoid, frame.vertical, metres=True
        )
        found = {
            line.name: profile_along(field, frame, line.shape, reference, step=parameters.step)
            for line in lines
        }
        doubts = _gaps(found)
        for line in doubts:
            feedback.warn(line)
        outputs = _write(project, parameters.target, found)
        summary: dict[str, Any] = {
            "products": [str(path) for path in outputs.values()],
            "of": field.name,
            "heights": reference.told,
            "profiles": [_told(name, profile) for name, profile in found.items()],
            "doubts": doubts,
        }
        return Result(outputs=outputs, summary=summary)


def _gaps(found: dict[str, Profile]) -> list[str]:
    """Where profiles have no height, in words."""
    import numpy as np

    out = []
    for name, profile in found.items():
        missing = np.isnan(profile.height)
        if missing.any():
            first, last = profile.station[missing][[0, -1]]
            out.append(
                f"{name}: {missing.sum()} of {len(missing)} stations have no height, the first at "
                f"{first:.1f} m, the last at {last:.1f} m"
            )
    return out


def _told(name: str, profile: Profile) -> dict[str, Any]:
    import numpy as np

    return {
        "name": name,
        "length_m": round(float(profile.station[-1]), 3),
        "stations": len(profile.station),
        "lowest_m": round(float(np.nanmin(profile.height)), 3),
        "highest_m": round(float(np.nanmax(profile.height)), 3),
        "sigma_m": round(float(np.nanmedian(profile.sigma)), 4),
        "sigma_local_m": round(float(np.nanmedian(profile.sigma_local)), 4),
        "without_height": int(np.isnan(profile.height).sum()),
    }


def _write(project: Project, target: Path | None, found: dict[str, Profile]) -> dict[str, Path]:
    """Write one table of all profiles, and a picture of each beside it."""
    from georef_gis.measure.report.draw import png
    from georef_gis.measure.surface.profile import profile_figure
    from georef_gis.rasters.files import export_errors, whole_file
    from processing_algorithms.measure.point_table import write_rows

    if target is None:
        project.products.mkdir(parents=True, exist_ok=True)
        target = project.products / "profile.csv"
    rows = [{"name": name, **row} for name, one in found.items() for row in one.rows]
    write_rows(target, rows, list(rows[0]))
    outputs = {"profile": target}
    for number, (name, profile) in enumerate(found.items(), start=1):
        path = target.with_suffix(".png") if number == 1 else \
            target.with_name(f"{target.stem}_{number}.png")  # fmt: skip
        data = png(profile_figure(profile, title=f"Profile {name}"))
        with export_errors(path, lambda: 0), whole_file(path) as stream:
            stream.write(data)
        outputs.setdefault("picture", path)
    return outputs
