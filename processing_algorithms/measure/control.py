"""Tool `control`: surveyed points into the project, blunders told, poses compared with them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.geodesy import MapFrame
    from georef_gis.ingest.control_places import Placed
    from georef_gis.model.control import Control, ControlObservations, Mark
    from georef_gis.orient.control_checks import ControlCheck
    from georef_gis.orient.control_model import JointCovariance
    from georef_gis.project import Project
    from processing_algorithms.site import Site


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoadedControl:
    """Control of a project with what was found wrong; parts are None where nothing is usable.

    `observations` holds all points that lie at the photos and all marks in photos with a pose;
    `check.keep` tells which of those marks to use.
    """

    doubts: tuple[str, ...]
    control: Control | None = None
    placed: Placed | None = None
    check: ControlCheck | None = None

    @property
    def observations(self) -> ControlObservations | None:
        """All points that lie at the photos and their good marks; None without any."""
        if self.placed is None or self.check is None:
            return None
        return self.placed.observations.with_marks(self.check.keep)

    @property
    def usable(self) -> ControlObservations | None:
        """Points that are not off and their good marks, for the adjustment; None without any."""
        found = self.observations
        return None if found is None else found.of_role("control", "check")


def examine_control(
    project: Project, site: Site, *, joint: JointCovariance | None = None
) -> LoadedControl | None:
    """Control points and marks of a project, tested against its poses; None if it has none.

    A file that cannot be used is a doubt, not an error: the result without control stays.
    """
    from georef_gis.errors import InputError
    from georef_gis.ingest.control_places import place_control
    from georef_gis.orient.control_checks import check_control

    if project.settings.control.file is None:
        return None
    try:
        control = _read(project)
        placed = place_control(control, site.frame, site.terrain, site.photos)
    except InputError as error:
        return LoadedControl(doubts=(f"{error} (no control is used)",))
    check = check_control(site.photos, placed.observations, site.terrain, joint=joint)
    doubts = (*control.doubts, *placed.doubts, *check.doubts)
    return LoadedControl(doubts=doubts, control=control, placed=placed, check=check)


def _read(project: Project) -> Control:
    """Points, roles and marks as project.toml says."""
    from georef_gis.ingest.control import ControlOptions, read_control, read_marks
    from georef_gis.ingest.control_places import with_roles

    s = project.settings.control
    own = project.settings.project.crs
    options = ControlOptions(
        format=s.format,
        crs=s.crs or (own if own.upper().startswith("EPSG:") else None),
        datum=s.datum,
        height_kind=s.height_kind,
        height_unit=s.height_unit,
        geoid=s.geoid,
        pixel_zero=s.pixel_zero,
        sigma_h=s.sigma_h_m,
        sigma_v=s.sigma_v_m,
        sigma_px=s.sigma_px,
    )
    assert s.file is not None
    control = read_control(project.path(s.file), options)
    if s.marks is not None:
        control = read_marks(project.path(s.marks), control, options)
    return with_roles(control, control_names=s.control, check=s.check, off=s.off)


class ControlPoints(Algorithm[p.Parameters]):
    """Read control and check points with their pixels, and compare the poses with them.

    Each marked pixel is laid on the ground by its photo's pose and compared with the surveyed
    place; beside the difference stands what the pose's sigma lets expect. Marks that do not agree
    with the others (wrong name, wrong photo, exchanged, from resized photos) are told one by one.
    Nothing is adjusted.
    """

    id, name, group = "control", "Control points", "measure"
    needs, gives = ("footprints",), ("control",)
    in_run = True
    uses_quick = True
    uses_settings = ("control", "ground", "project")
    version = "4"

    def inputs(self, context: Context, parameters: p.Parameters) -> Sequence[Path]:
        """Points and marks."""
        project = context.require_project()
        control = project.settings.control
        return [project.path(file) for file in (control.file, control.marks) if file is not None]

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        """Read and compare."""
        from processing_algorithms.site import load_site

        project = context.require_project()
        if project.settings.control.file is None:
            _save(project, [], [])
            return Result(summary={})
        site = load_site(project, quick=context.quick)
        loaded = examine_control(project, site)
        assert loaded is not None
        for doubt in loaded.doubts:
            feedback.warn(doubt)
        summary: dict[str, Any] = {"points": 0, "marks": 0, "doubts": list(loaded.doubts)}
        if loaded.placed is None or loaded.control is None:
            _save(project, [], [])
            return Result(summary=summary)
        _save(project, _point_rows(loaded, site.frame), _mark_rows(loaded, site))
        roles = [point.role for point in loaded.placed.points]
        summary |= {
            "points": len(roles),
            "control_points": roles.count("control"),
            "check_points": roles.count("check"),
            "marks": len(loaded.control.marks),
        }
        used = (project.database.meta("adjustment") or {}).get("control_points", [])
        return Result(summary=summary | _compared(site, loaded, used))


def _point_rows(loaded: LoadedControl, frame: MapFrame) -> list[dict[str, Any]]:
    from georef_gis.project.geometry import point_wkb

    control, placed = loaded.control, loaded.placed
    assert control is not None
    assert placed is not None
    rows = []
    for point, place in zip(placed.points, frame.map_from_geo(placed.geo), strict=True):
        rows.append(
            {
                "name": point.name,
                "role": point.role,
                "easting": point.easting,
                "northing": point.northing,
                "height": point.height,
                "height_kind": str(placed.height_kind),
                "sigma_h_m": point.sigma_h,
                "sigma_v_m": point.sigma_v,
                "crs": control.crs.to_string(),
                "datum": str(control.datum),
                "extra": {"source": point.source},
                "geom": point_wkb(*(float(v) for v in place)),
            }
        )
    return rows


def _mark_rows(loaded: LoadedControl, site: Site) -> list[dict[str, Any]]:
    """Marks with their photo's id and how they compare; one of each point and photo."""
    from georef_gis.ingest.control_photos import photo_finder

    find = photo_finder(site.photos)
    assert loaded.control is not None
    found = _findings(loaded)
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for mark in loaded.control.marks:
        ids = find(mark.photo)
        key = ids[0] if len(ids) == 1 else mark.photo
        extra = {"source": mark.source} | found.get(_key(mark, key), {"used": False})
        row = {
            "name": mark.name, "photo_id": key, "u": mark.u, "v": mark.v,
            "sigma_px": mark.sigma_px, "extra": extra,
        }  # fmt: skip
        before = rows.get((mark.name, key))
        if before is None or extra.get("used"):
            if before is not None:
                extra["also_at"] = [before["u"], before["v"]]
            rows[mark.name, key] = row
        else:
            before["extra"]["also_at"] = [mark.u, mark.v]
    return list(rows.values())


def _key(mark: Mark, photo_id: str) -> tuple[str, str, float, float]:
    return mark.name, photo_id, mark.u, mark.v


def _findings(loaded: LoadedControl) -> Mapping[tuple[str, str, float, float], dict[str, Any]]:
    import numpy as np

    placed, check = loaded.placed, loaded.check
    assert placed is not None
    assert check is not None
    o = placed.observations
    out = {}
    for k, photo in enumerate(o.photo_ids):
        values: dict[str, Any] = {
            "used": bool(check.keep[k]) and o.role[o.point[k]] != "off",
            "suspect": bool(check.suspect[k]),
        }
        if np.all(np.isfinite(check.residual[k])):
            values["off_px"] = [round(float(v), 2) for v in check.residual[k]]
        if check.fits[k] >= 0:
            values["fits"] = o.names[check.fits[k]]
        out[o.names[o.point[k]], photo, float(o.uv[k, 0]), float(o.uv[k, 1])] = values
    return out


def _save(project: Project, points: list[dict[str, Any]], marks: list[dict[str, Any]]) -> None:
    with project.database.transaction():
        project.database.replace_rows("control", points)
        project.database.replace_rows("mark", marks)


def _compared(site: Site, loaded: LoadedControl, used: Collection[str]) -> dict[str, Any]:
    """How far the good marks land from the surveyed places, and what was to be expected.

    Of points that are not off. A mark that was called wrong does not count, though one of a check
    point stays for the accuracy statement: it tells of a click, not of the poses. `used` names the
    points that the photos were adjusted to: what is expected holds for marks of others.
    """
    import numpy as np

    placed, check = loaded.placed, loaded.check
    assert placed is not None
    assert check is not None
    o = placed.observations
    asked = [k for k, j in enumerate(o.point) if o.role[j] != "off"]
    good = [k for k in asked if check.keep[k] and not check.suspect[k]]
    landed = [_landed(site, o, k) for k in good]
    found = [one for one in landed if one is not None]
    told = {"wrong_marks": len(asked) - len(good)}
    held = [
        k for k, one in zip(good, landed, strict=True)
        if one is not None and o.names[o.point[k]] in used
        and site.photos[o.photo_ids[k]].pose.kind == "adjusted"
    ]  # fmt: skip
    if not found:
        return told
    rms = np.sqrt(np.mean([off**2 for off, _ in found], axis=0))
    expected = np.sqrt(np.mean([variance for _, variance in found], axis=0))
    return {
        "compared": len(found),
        **told,
        "marks_adjusted_to": len(held),
        "rms_east_m": round(float(rms[0]), 3),
        "rms_north_m": round(float(rms[1]), 3),
        "expected_sigma_east_m": round(float(expected[0]), 3),
        "expected_sigma_north_m": round(float(expected[1]), 3),
        # of both axes, where one figure has to do
        "expected_sigma_m": round(float(np.sqrt(np.mean(expected**2))), 3),
    }


def _landed(site: Site, o: ControlObservations, mark: int) -> tuple[Array, Array] | None:
    """Where a mark lands less its surveyed place, and variance: east, north; m, m^2; each (2,).

    None where its ray does not meet the ground.
    """
    import numpy as np

    from georef_gis.errors import GeometryError
    from georef_gis.model.ground_point import ground_point_covariance, locate

    photo = site.photos[o.photo_ids[mark]]
    try:
        found = locate(photo, o.uv[mark], site.terrain)
        if not np.all(np.isfinite(found)):
            return None
        covariance = ground_point_covariance(
            photo, found, site.terrain, sigma_uv=float(o.sigma_px[mark])
        )
    except GeometryError:
        return None
    off = np.asarray(found[:2] - o.p_enu[o.point[mark], :2])
    return off, np.asarray(np.diag(covariance)[:2])
