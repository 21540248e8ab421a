"""Tool `assets`: mapped assets of a project: clicks in, table and pictures out, edits undone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.project.spreadsheet import guarded
from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.measure.assets.asset import Asset
    from georef_gis.measure.assets.store import AssetStore
    from georef_gis.project import Project
    from processing_algorithms.assets.asset_clicks import MeasuredDraft
    from processing_algorithms.measure.session import MeasureSession

COLUMNS = (
    "asset_id", "class", "name", "easting", "northing", "height_ellipsoidal_m", "vertices",
    "sigma_e_m", "sigma_n_m", "sigma_u_m", "corr_en", "semi_major_m", "semi_minor_m",
    "azimuth_deg", "conf", "dof", "n_rays", "method", "photos", "pixels", "sigma_px",
    "attributes", "note", "revision", "created", "changed", "problems",
)  # fmt: skip
# Doubts of single assets that are told, before the rest is counted.
_MOST_TOLD = 10
_MOST_NAMES = 5
# A spreadsheet runs a cell that begins so.


class AssetsParameters(p.Parameters):
    """Parameters of `assets`."""

    clicks: p.File | None = p.file(
        None, title="CSV of clicks to measure and store: class, photo, u, v",
        help="Further columns: asset (one name for all clicks of one), vertex (from 1), sigma_px, "
        "note, and attributes of the class. An asset of that class and name is measured anew.",
    )  # fmt: skip
    remeasure: p.Flag = p.flag(
        False, title="Measure all clicked assets again, with the poses of now"
    )
    undo: p.Integer = p.integer(0, title="Steps to undo", ge=0, le=1000)
    redo: p.Integer = p.integer(0, title="Steps to redo", ge=0, le=1000)
    click: p.Number = p.number(0.5, title="One sigma of a click that states none, px", gt=0, le=100)
    thumbnails: p.Flag = p.flag(False, title="Cut a picture of every asset out of its best photo")
    target: p.File | None = p.file(
        None, title="CSV or JSON of all assets; else products/assets.csv",
        suffixes=(".csv", ".json"), writes=True,
    )  # fmt: skip


class Assets(Algorithm[AssetsParameters]):
    """Assets of the project: measure clicks, undo and redo edits, table and pictures.

    They are kept in assets.gpkg, which opens in QGIS and may be edited there; such edits are found
    and can be undone too. Without parameters the table is written anew.
    """

    id, name, group = "assets", "Assets", "measure"
    about = "assets"
    needs = ("poses",)
    outputs = (
        Output(name="layers", title="Layers of assets", type="VectorLayer"),
        Output(name="table", title="Table of all assets"),
        Output(name="thumbnails", title="Pictures", type="Folder"),
    )

    def run(self, context: Context, parameters: AssetsParameters, feedback: Feedback) -> Result:
        """Undo and redo, measure, list."""
        from georef_gis.errors import InputError
        from georef_gis.measure.assets.store import AssetStore

        project = context.require_project()
        if parameters.undo and parameters.redo:
            raise InputError("give undo or redo, not both", field="undo")
        with AssetStore.of_project(project) as store:
            counts = {
                "undone": _turn(store, "undo", parameters.undo, feedback),
                "redone": _turn(store, "redo", parameters.redo, feedback),
            }
            session = _session_if_needed(project, parameters)
            if session is not None and parameters.clicks is not None:
                counts["stored"] = _import(store, session, parameters, feedback)
            if session is not None and parameters.remeasure:
                counts["measured_again"] = _remeasure(store, session, parameters, feedback)
            assets = store.assets()
            outputs = {"layers": store.path}
        _tell_problems(assets, feedback)
        lost = _lost(project, assets, feedback)
        outputs["table"] = _write_table(project, parameters.target, assets, lost)
        if session is not None and parameters.thumbnails:
            outputs["thumbnails"] = _pictures(project, session, assets, feedback)
        kinds: dict[str, int] = {}
        for asset in assets:
            kinds[asset.kind] = kinds.get(asset.kind, 0) + 1
        summary = {"assets": len(assets), "classes": kinds,
                   **{name: n for name, n in counts.items() if n}}  # fmt: skip
        return Result(outputs=outputs, summary=summary)


def _session_if_needed(project: Project, parameters: AssetsParameters) -> MeasureSession | None:
    from processing_algorithms.measure.session import MeasureSession

    if parameters.clicks or parameters.remeasure or parameters.thumbnails:
        return MeasureSession.open(project)
    return None


def _turn(store: AssetStore, which: str, count: int, feedback: Feedback) -> int:
    """Undo or redo steps; how many there were."""
    for k in range(count):
        step = store.undo() if which == "undo" else store.redo()
        if step is None:
            only = f"there {'was' if k == 1 else 'were'} only {k} step{'s' * (k != 1)} to {which}"
            feedback.warn(only if k else f"nothing to {which}")
            return k
        feedback.info(f"{which}: {step.title} ({len(step.asset_ids)} assets, {step.at})")
    return count


def _import(
    store: AssetStore, session: MeasureSession, parameters: AssetsParameters, feedback: Feedback
) -> int:
    """Measure and store the assets of the table as one step; how many there were."""
    from georef_gis.errors import InputError
    from processing_algorithms.assets.asset_clicks import measure_clicked, read_clicks

    assert parameters.clicks is not None
    clicked = read_clicks(parameters.clicks, store.domain)
    measured = measure_clicked(session, clicked, sigma_px=parameters.click)
    _tell(measured, feedback)
    placed = [one for one in measured if one.draft is not None]
    if not placed:
        raise InputError(f"none of its {len(measured)} assets has a place; see the warnings",
                         source=str(parameters.clicks))  # fmt: skip
    old: dict[tuple[str, str], list[Asset]] = {}
    for asset in store.assets():
        old.setdefault((asset.kind, asset.name), []).append(asset)
    with store.step(f"clicks of {parameters.clicks.name}"):
        for one in placed:
            same = old.get((one.clicked.kind, one.clicked.name), []) if one.clicked.name else []
            _store(store, one, same)
    return len(placed)


def _store(store: AssetStore, one: MeasuredDraft, same: Sequence[Asset]) -> None:
    """Add an asset, or measure the one of its class and name anew."""
    from georef_gis.errors import InputError
    from georef_gis.measure.assets.store import Change

    draft, where = one.draft, one.clicked.source
    assert draft is not None
    if len(same) > 1:
        raise InputError(f"{len(same)} assets of class {draft.kind} have the name "
                         f"'{draft.name[:40]}'; give them names of their own",
                         source=where)  # fmt: skip
    if not same:
        try:
            store.add(draft)
        except InputError as error:
            raise InputError(str(error), source=where) from error
        return
    change = Change(
        vertices=draft.vertices,
        quality=draft.quality,
        attributes={**same[0].attributes, **draft.attributes},
        note=draft.note or None,
    )
    store.change(same[0].id, same[0].revision, change)


def _remeasure(
    store: AssetStore, session: MeasureSession, parameters: AssetsParameters, feedback: Feedback
) -> int:
    from georef_gis.measure.assets.store import Change
    from processing_algorithms.assets.asset_clicks import remeasured
    from processing_algorithms.assets.asset_photos import lost_photos

    found = remeasured(session, store.assets(), sigma_px=parameters.click)
    known = _photo_ids(session.project)
    # Those of photos that are gone are told in one line, with the assets as they are in the end.
    _tell([one for asset, one in found if not lost_photos(asset, known)], feedback)
    placed = [(asset, one.draft) for asset, one in found if one.draft is not None]
    if len(placed) < len(found):
        left = len(found) - len(placed)
        feedback.warn(
            f"{left} of {len(found)} clicked assets {'stays' if left == 1 else 'stay'} as "
            f"{'it is' if left == 1 else 'they are'}; the others were measured again"
            if placed else f"none of {len(found)} clicked assets could be measured again; all stay "
            "as they are"
        )  # fmt: skip
    if not placed:
        return 0
    with store.step("measure again"):
        for asset, draft in placed:
            change = Change(vertices=draft.vertices, quality=draft.quality)
            store.change(asset.id, asset.revision, change)
    return len(placed)


def _tell(measured: Sequence[MeasuredDraft], feedback: Feedback) -> None:
    """Warn of what was refused, and of doubts."""
    lines = []
    for one in measured:
        clicked = one.clicked
        what = f"{clicked.kind} {clicked.name}".strip()
        where = f"{clicked.source}: {what}" if clicked.source else what
        if one.refused:
            lines.append(f"{where} is not measured: {one.refused}")
        lines += [f"{where}: {doubt}" for doubt in one.doubts]
    for line in lines[:_MOST_TOLD]:
        feedback.warn(line)
    if len(lines) > _MOST_TOLD:
        feedback.warn(f"and {len(lines) - _MOST_TOLD} lines more of the kind")


def _tell_problems(assets: Sequence[Asset], feedback: Feedback) -> None:
    """Warn of what does not fit, once for all assets that have it."""
    found: dict[str, list[str]] = {}
    for asset in assets:
        for problem in asset.problems:
            found.setdefault(problem, []).append(f"{asset.kind} {asset.name[:40] or asset.id}")
    for problem, names in found.items():
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        feedback.warn(f"{problem} [{', '.join(names[:_MOST_NAMES])}{more}]")


def _lost(project: Project, assets: Sequence[Asset], feedback: Feedback) -> dict[str, str]:
    """What is said, by id, of assets that were clicked in photos which are gone."""
    from processing_algorithms.assets.asset_photos import lost_lines, lost_photos, lost_words

    known = _photo_ids(project)
    for line in lost_lines(assets, known):
        feedback.warn(line)
    return {a.id: lost_words(gone) for a in assets if (gone := lost_photos(a, known))}


def _photo_ids(project: Project) -> set[str]:
    return {str(row["photo_id"]) for row in project.database.rows("photo")}


def _write_table(
    project: Project, target: Path | None, assets: Sequence[Asset], lost: Mapping[str, str]
) -> Path:
    from processing_algorithms.measure.point_table import write_rows

    path = target or project.products / "assets.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [asset_row(asset) for asset in assets]
    for row in rows:
        told = (row["problems"], lost.get(row["asset_id"], ""))
        row["problems"] = "; ".join(filter(None, told))
    if path.suffix.lower() != ".json":
        rows = [
            {name: guarded(v) if isinstance(v, str) else v for name, v in row.items()}
            for row in rows
        ]
    write_rows(path, rows, COLUMNS)
    return path


def asset_row(asset: Asset) -> dict[str, Any]:
    """Row of an asset, `COLUMNS`; the place is that of its first vertex."""
    from georef_gis.measure.assets.asset import Quality

    q = asset.quality or Quality()
    e, n, h = asset.vertices[0] if asset.vertices else (None, None, None)
    return {
        "asset_id": asset.id,
        "class": asset.kind,
        "name": asset.name,
        "easting": None if e is None else round(e, 4),
        "northing": None if n is None else round(n, 4),
        "height_ellipsoidal_m": None if h is None or h != h else round(h, 4),
        "vertices": len(asset.vertices),
        "sigma_e_m": _round(q.sigma_e),
        "sigma_n_m": _round(q.sigma_n),
        "sigma_u_m": _round(q.sigma_u),
        "corr_en": _round(q.corr_en),
        "semi_major_m": _round(q.semi_major),
        "semi_minor_m": _round(q.semi_minor),
        "azimuth_deg": _round(q.azimuth),
        "conf": q.conf,
        "dof": q.dof,
        "n_rays": q.n_rays,
        "method": q.method,
        "photos": ";".join(q.photo_ids),
        "pixels": ";".join(f"{c.u:.2f},{c.v:.2f}" for c in q.clicks),
        "sigma_px": ";".join(f"{c.sigma_px:.3g}" if c.sigma_px else "" for c in q.clicks),
        "attributes": json.dumps(dict(asset.attributes), ensure_ascii=False),
        "note": asset.note,
        "revision": asset.revision,
        "created": asset.created,
        "changed": asset.changed,
        "problems": "; ".join(asset.problems),
    }


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def _pictures(
    project: Project, session: MeasureSession, assets: Sequence[Asset], feedback: Feedback
) -> Path:
    from georef_gis.measure.assets.thumbnails import remove_others, write_thumbnails
    from processing_algorithms.assets.asset_clicks import sights_of

    folder = project.products / "assets"
    _, notes = write_thumbnails(sights_of(session, assets), folder)
    for note in notes:
        feedback.warn(note)
    remove_others(folder, [asset.id for asset in assets])
    return folder
