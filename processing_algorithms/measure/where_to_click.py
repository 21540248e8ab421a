"""Tool `where_to_click`: the predicted pixel of every control point in every photo."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.model.control import ControlObservations
    from georef_gis.model.photo import OrientedPhoto
    from georef_gis.orient.control_model import PredictedPixels


class WhereToClickParameters(p.Parameters):
    """Parameters of `where_to_click`."""

    point: tuple[p.Text, ...] = p.text(
        (), title="Only this point; give it once per point", advanced=False
    )
    best: p.Integer = p.integer(0, title="Photos per point, 0 = all", ge=0, le=100_000)
    target: p.File | None = p.file(
        None, title="CSV to write; else products/where_to_click.csv", writes=True
    )


class WhereToClick(Algorithm[WhereToClickParameters]):
    """Where every control point shows in every photo, best photo first.

    Pixel and standard ellipse by pose, camera and survey. First come photos that show the point
    near their middle and for which the prediction is sharp. Marks already there are listed with
    their distance from the prediction.
    """

    id, name, group = "where_to_click", "Where to click control points", "measure"
    needs = ("footprints",)
    outputs = (Output(name="pixels", title="Predicted pixels as CSV"),)

    def run(
        self, context: Context, parameters: WhereToClickParameters, feedback: Feedback
    ) -> Result:
        """Predict."""
        from georef_gis.errors import InputError
        from georef_gis.orient.control_model import predict_pixels
        from processing_algorithms.measure.control import examine_control
        from processing_algorithms.site import load_site

        project = context.require_project()
        site = load_site(project, quick=context.quick)
        loaded = examine_control(project, site)
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
        found = predict_pixels(site.photos, o, site.terrain)
        rows = _rows(found, o, site.photos)
        rows = [row for row in rows if not parameters.point or row["name"] in parameters.point]
        if parameters.best:
            rows = [row for row in rows if row["rank"] <= parameters.best]
        unseen = [n for n in (parameters.point or o.names) if all(r["name"] != n for r in rows)]
        if unseen:
            feedback.warn(f"no photo shows {', '.join(unseen[:10])} by its pose")
        target = parameters.target or project.products / "where_to_click.csv"
        _write(target, rows)
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
    found: PredictedPixels, o: ControlObservations, photos: dict[str, OrientedPhoto]
) -> list[dict[str, Any]]:
    """A row per pair, by point and then best photo first.

    The rank is by the distance from the middle plus the longer half axis, both in half diagonals.
    """
    import numpy as np

    marked = {(key, int(j)): uv for key, j, uv in zip(o.photo_ids, o.point, o.uv, strict=True)}
    axes = found.axes
    rows = []
    for k, key in enumerate(found.photo_ids):
        camera = photos[key].camera
        half = math.hypot(camera.width, camera.height) / 2
        middle = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
        away = float(np.linalg.norm(found.uv[k] - middle)) / half
        longest = np.linalg.eigh(found.covariance[k])[1][:, 1]
        at = marked.get((key, int(found.point[k])))
        rows.append(
            {
                "name": o.names[found.point[k]],
                "rank": 0,
                "photo": key,
                "u": round(float(found.uv[k, 0]), 1),
                "v": round(float(found.uv[k, 1]), 1),
                "sigma_major_px": round(float(axes[k, 0]), 1),
                "sigma_minor_px": round(float(axes[k, 1]), 1),
                # clockwise from the top of the image
                "ellipse_azimuth_deg": round(
                    math.degrees(math.atan2(longest[0], -longest[1])) % 180, 0
                ),
                "from_middle": round(away, 3),
                "marked_u": "" if at is None else round(float(at[0]), 2),
                "marked_v": "" if at is None else round(float(at[1]), 2),
                "score": away + float(axes[k, 0]) / half,
            }
        )
    rows.sort(key=lambda row: (row["name"], row["score"]))
    rank = 0
    for i, row in enumerate(rows):
        rank = rank + 1 if i and rows[i - 1]["name"] == row["name"] else 1
        row["rank"] = rank
    return rows


def _write(target: Path, rows: list[dict[str, Any]]) -> None:
    import csv
    import io

    from georef_gis.rasters.files import export_errors, resolve_target, whole_file

    text = io.StringIO(newline="")
    writer = csv.DictWriter(
        text, fieldnames=_COLUMNS, lineterminator="\n", extrasaction="ignore"
    )  # fmt: skip
    writer.writeheader()
    writer.writerows(rows)
    target.parent.mkdir(parents=True, exist_ok=True)
    with export_errors(target, lambda: 0), whole_file(resolve_target(target)) as stream:
        stream.write(text.getvalue().encode())
