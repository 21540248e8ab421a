"""Tool `match`: tie points between the photos."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.orient.ties import TieResult

TIES, MATCHES = "ties.npz", "matches.json"


class MatchParameters(p.Parameters):
    """How tie points are sought."""

    max_side: p.Integer = p.integer(
        2000, title="Longer side", unit="px", ge=400, le=20000,
        help="Larger photos are reduced to it for the search",
    )  # fmt: skip
    observations: p.Integer = p.integer(
        800, title="Tie points per photo", ge=50, le=20000, advanced=True,
        help="About so many are kept, spread over the photo",
    )  # fmt: skip
    neighbours: p.Integer = p.integer(
        14, title="Neighbours", ge=2, le=200, advanced=True,
        help="Photos with which each one is compared, those of largest overlap",
    )  # fmt: skip


class Match(Algorithm[MatchParameters]):
    """Find points that several photos show.

    Features are sought once per photo and kept; the poses tell which photos overlap and where a
    feature of one lies in the other; the geometry of each pair tells right matches from wrong
    ones. Photos whose pixels contradict the heading of their tags are found.
    """

    id, name, group = "match", "Match photos", "orient"
    needs, gives = ("photos", "poses"), ("ties",)
    in_run = True
    in_quick = False
    refines = True
    uses_settings = ("ground",)

    def inputs(self, context: Context, parameters: MatchParameters) -> Sequence[Path]:
        """The photos."""
        project = context.require_project()
        rows = project.database.rows("photo")
        return [project.path(row["path"]) for row in rows if row["status"] != "refused"]

    def run(self, context: Context, parameters: MatchParameters, feedback: Feedback) -> Result:
        """Match them."""
        from georef_gis.orient.adjustment.keep import save_ties
        from georef_gis.orient.ties import TieSettings, find_ties
        from processing_algorithms.site import load_site

        project = context.require_project()
        site = load_site(project, direct=True)
        settings = TieSettings(
            max_side=parameters.max_side,
            observations=parameters.observations,
            neighbours=parameters.neighbours,
            workers=context.workers,
            seed=context.seed,
        )

        def told(share: float, what: str) -> None:
            check_cancelled(feedback)
            feedback.progress(share, what)

        photos = [_found(project.path(o.photo.path), o) for o in site.photos.values()]
        found = find_ties(
            photos, site.terrain, settings, cache=project.cache / "features", progress=told
        )
        doubts = list(found.doubts) if len(photos) > 1 else []
        for doubt in doubts:
            feedback.warn(doubt)
        folder = project.adjustment
        folder.mkdir(exist_ok=True)
        ties = found.ties
        save_ties(folder / TIES, ties)
        content = json.dumps(_content(found), indent=1)
        part = folder / (MATCHES + ".part")
        part.write_text(content, encoding="utf-8")
        part.replace(folder / MATCHES)
        largest = found.components[0] if found.components else ()
        summary = {
            "photos": len(photos),
            "connected": len(largest),
            "groups": len(found.components),
            "points": ties.n_points,
            "observations": len(ties.photo),
            "pairs": sum(pair.inliers > 0 for pair in found.pairs),
            "doubts": doubts,
        }
        return Result(outputs={"ties": folder / TIES, "matches": folder / MATCHES}, summary=summary)


def _found(path: Path, oriented: Any) -> Any:
    """Photo whose file is found from here."""
    from dataclasses import replace

    return replace(oriented, photo=replace(oriented.photo, path=path))


def _content(found: TieResult) -> dict[str, Any]:
    """Pairs, turns and groups as plain values."""
    from dataclasses import asdict

    pairs = [{k: _plain(v) for k, v in asdict(pair).items()} for pair in found.pairs]
    turns = {
        key: {k: _plain(v) for k, v in asdict(turn).items()}
        for key, turn in found.turns.items()
        if turn.is_change
    }
    return {
        "pairs": pairs,
        "turns": turns,
        "components": [list(group) for group in found.components],
        "doubts": list(found.doubts),
        "seconds": {key: round(value, 3) for key, value in found.seconds.items()},
    }


def _plain(value: Any) -> Any:
    """JSON has no NaN; numpy's numbers become Python's."""
    import math

    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    return list(value) if isinstance(value, tuple) else value
