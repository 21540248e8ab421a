"""Tool `where_to_click`: the predicted pixel of every control point in every photo."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p
from processing_algorithms.measure.point_table import TABLE_SUFFIXES

if TYPE_CHECKING:
    from georef_gis.measure.scene import Scene
    from georef_gis.model.control import ControlObservations


class WhereToClickParameters(p.Parameters):
    """Parameters of `where_to_click`."""

    point: tuple[p.Text, ...] = p.text(
        (), title="Only this point; give it once per point", advanced=False
    )
    best: p.Integer = p.integer(0, title="Photos per point, 0 = all", ge=0, le=100_000)
    target: p.File | None = p.file(
        None, title="CSV or JSON to write; else products/where_to_click.csv",
        suffixes=TABLE_SUFFIXES, writes=True,
    )  # fmt: skip


class WhereToClick(Algorithm[WhereToClickParameters]):
    """Where every control point shows in every photo, best photo first.

    Pixel and standard ellipse by pose, camera and survey. First come photos that show the point
    near their middle and for which the prediction is sharp. Marks already there are listed with
    their distance from the prediction.
    """

    id, name, group = "where_to_click", "Where to click control points", "measure"
    about = "points"
    needs = ("footprints",)
    outputs = (Output(name="pixels", title="Predicted pixels as CSV"),)

    def run(
        self, context: Context, parameters: WhereToClickParameters, feedback: Feedback
    ) -> Result:
        """Predict."""
        from georef_gis.errors import InputError
        from processing_algorithms.measure.control import examine_control
        from processing_algorithms.measure.point_table import write_rows
        from processing_algorithms.measure.session import MeasureSession

        project = context.require_project()
        session = MeasureSession.open(project, quick=context.quick)
        loaded = examine_control(project, session.site)
        if loaded is None:
            raise InputError(
                "no control points are named; give [control] file",
                source=str(project.path(Path("project.toml"))),
                field="control.file",
            )
        if loaded.placed is None:
            raise InputError(loaded.doubts[0])
        o = loaded.placed.observations
        strange = [name for name in parameters.point if name not in o.names]
        if strange:
            raise InputError(
                f"no usable point is called '{strange[0]}'; names are {', '.join(o.names[:10])}",
                field="point",
            )
        chosen = [j for j, n in enumerate(o.names) if n in (parameters.point or o.names)]
        rows = _rows(session.scene, o, chosen, parameters.best or None)
        unseen = [n for n in (parameters.point or o.names) if all(r["name"] != n for r in rows)]
        if unseen:
            feedback.warn(f"no photo shows {', '.join(unseen[:10])} by its pose")
        target = parameters.target or project.products / "where_to_click.csv"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_rows(target, rows, _COLUMNS)
        summary = {
            "pairs": len(rows),
            "points_seen": len({row["name"] for row in rows}),
            "points_unseen": len(unseen),
        }
        return Result(outputs={"pixels": target}, summary=summary)


_COLUMNS = (
    "name", "rank", "photo", "u", "v", "sigma_major_px", "sigma_minor_px", "ellipse_azimuth_deg",
    "from_middle", "marked_u", "marked_v",
)  # fmt: skip


def _rows(
    scene: Scene, o: ControlObservations, chosen: Sequence[int], best: int | None
) -> list[dict[str, Any]]:
    """A row per point and photo, by name of the point and then best photo first."""
    import numpy as np

    from georef_gis.measure.who_sees import who_sees
    from georef_gis.orient.control_model import prior_sigmas, shift_sigmas
    from processing_algorithms.measure.who_sees import sighting_row

    marked = {(key, int(j)): uv for key, j, uv in zip(o.photo_ids, o.point, o.uv, strict=True)}
    sigma = prior_sigmas(o, scene.terrain)
    shift = shift_sigmas(o, scene.photos.photos)
    rows = []
    for j in sorted(chosen, key=lambda j: o.names[j]):
        place = np.diag(sigma[j] ** 2 + shift**2)
        # also where the ground seems to stand between: a control point is looked for in all
        found = who_sees(scene, o.p_enu[j], place, best=best, hidden=True)
        for rank, one in enumerate(found, start=1):
            at = marked.get((one.photo_id, j))
            rows.append(
                {
                    "name": o.names[j],
                    **sighting_row(one, rank),
                    "marked_u": "" if at is None else round(float(at[0]), 2),
                    "marked_v": "" if at is None else round(float(at[1]), 2),
                }
            )
    return rows
