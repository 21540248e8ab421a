"""What the report page tells besides the database: error budget, assets, versions, settings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.measure.assets.asset import Asset
    from georef_gis.measure.report.assets_section import AssetFacts
    from georef_gis.measure.report.budget_section import Budget
    from georef_gis.measure.report.facts import Facts
    from georef_gis.measure.report.runs_section import Made
    from georef_gis.project import Project
    from processing_algorithms.site import Site

# photos of which the budget is taken apart; more, evenly chosen, say the same
MOST_PHOTOS = 120
# px of a picture of an asset, and its JPEG quality
_SIDE, _QUALITY = 168, 78


def budget_of(project: Project, site: Site) -> tuple[Budget | None, str]:
    """Error budget of the photos; else None, and why, in a sentence."""
    from numpy.linalg import LinAlgError

    from georef_gis.errors import GeorefError
    from georef_gis.measure.budget.shares import photo_budgets, remedies, usual_budget
    from georef_gis.measure.report.budget_section import Budget
    from processing_algorithms.measure.budget_sources import error_sources
    from processing_algorithms.measure.session import MeasureSession

    notes: list[str] = []
    try:
        session = MeasureSession(project, site)
        errors = error_sources(project, site, session.scene.errors, notes)
        ids = list(site.photos)
        step = max(len(ids) / MOST_PHOTOS, 1.0)
        chosen = [ids[int(k * step)] for k in range(min(len(ids), MOST_PHOTOS))]
        each, refused = photo_budgets(session.scene, chosen, errors)
        whole = usual_budget(each, "usual")
    except (GeorefError, OSError, LinAlgError) as error:
        return None, f"There is no error budget: {error}."
    notes += refused.values()
    found = remedies(whole)
    return Budget(whole=whole, each=each, found=found, of=len(ids), notes=tuple(notes)), ""


# -- assets --------------------------------------------------------------------------------------


def assets_of(project: Project) -> tuple[AssetFacts | None, str]:
    """Assets of a project with pictures of some; else None, and why, in a sentence."""
    from georef_gis.errors import GeorefError
    from georef_gis.geodesy import metres_per_unit
    from georef_gis.measure.assets.file import ASSETS_FILE
    from georef_gis.measure.assets.store import AssetStore
    from georef_gis.measure.report.assets_section import AssetFacts
    from georef_gis.project.records import load_frame

    # a look must not make the file
    if not (project.folder / ASSETS_FILE).is_file():
        return None, ""
    try:
        with AssetStore.of_project(project) as store:
            assets = store.assets()
            titles = {name: one.title for name, one in store.domain.classes.items()}
    except GeorefError as error:
        return None, f"The assets cannot be read: {error}."
    return AssetFacts(
        assets=assets,
        titles=titles,
        unit=metres_per_unit(load_frame(project.database).horizontal),
        photos=frozenset(str(row["photo_id"]) for row in project.database.rows("photo")),
        pictures=_pictures(project, assets),
    ), ""


def _pictures(project: Project, assets: list[Asset]) -> dict[str, bytes]:
    """Pictures that `georef assets --thumbnails` cut and that are not older than the assets."""
    from datetime import datetime

    from georef_gis.measure.assets.thumbnails import thumbnail_name
    from georef_gis.measure.report.assets_section import pictured

    out: dict[str, bytes] = {}
    folder = project.products / "assets"
    if not folder.is_dir():
        return out
    for asset in pictured([a for a in assets if (folder / thumbnail_name(a.id)).is_file()]):
        path = folder / thumbnail_name(asset.id)
        try:
            changed = datetime.fromisoformat(asset.changed).timestamp()
        except ValueError:
            changed = 0.0
        if path.stat().st_mtime >= changed and (small := _small(path)) is not None:
            out[asset.id] = small
    return out


def _small(path: Any) -> bytes | None:
    """A picture as a small JPEG; None where the file is none."""
    import cv2
    import numpy as np

    picture = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        return None
    small = cv2.resize(picture, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    done, raw = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return raw.tobytes() if done else None


# -- how it was made -----------------------------------------------------------------------------


def made_by(project: Project, facts: Facts) -> Made:
    """Versions, project.toml, and the tools whose settings changed since they ran."""
    from georef_gis.measure.report.runs_section import Made
    from georef_gis.project.fingerprint import digest
    from georef_gis.project.project import SETTINGS_FILE
    from georef_gis.project.settings import SECTIONS

    now = {name: digest(project.settings.section(name)) for name in SECTIONS}
    changed = {}
    for run in facts.runs:
        parts = [k for k, v in (run["settings"] or {}).items() if now.get(k) != v]
        name = run["tool"].rpartition(":")[2]
        if parts and name != "report":
            changed[name] = tuple(sorted(parts))
    try:
        text = (project.folder / SETTINGS_FILE).read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        text = f"project.toml cannot be read ({error.strerror})"
    return Made(versions=versions(), settings=text, changed=changed)


def versions() -> tuple[tuple[str, str], ...]:
    """Of the package, of Python, of the system, and of the libraries that are there, in a row."""
    import platform
    import re
    from importlib.metadata import PackageNotFoundError, requires, version

    import georef_gis

    out: dict[str, str] = {}
    for line in requires("georef-gis") or ():
        name = re.match(r"[\w.-]+", line)
        if name is None or 'extra == "dev"' in line:
            continue
        try:
            out[name.group()] = version(name.group())
        except PackageNotFoundError:
            continue
    return (
        ("georef-gis", georef_gis.__version__),
        ("Python", f"{platform.python_version()} on {platform.platform(terse=True)}"),
        ("Libraries", ", ".join(f"{name} {number}" for name, number in sorted(out.items()))),
    )
