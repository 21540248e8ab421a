"""Tool `adjust`: poses, cameras, mount, clock and ground from tie points, navigation, control."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.model.control import ControlObservations
    from georef_gis.orient.adjustment.adjust import Adjusted
    from georef_gis.orient.adjustment.checks import Check
    from georef_gis.project import Project
    from processing_algorithms.orient.blocks import Prepared
    from processing_algorithms.site import Site


# one sigma of a focal length of which nothing is believed, as a share of it
FOCAL_UNKNOWN = 0.3
# chi-square by which another focal length must agree better: ten sigmas
BEYOND_DOUBT = 100.0


class AdjustParameters(p.Parameters):
    """How the block is adjusted."""

    calibrate: p.Flag = p.flag(
        True, title="Calibrate the camera",
        help="Focal length, principal point and distortion move as far as the photos tell them "
        "and their priors let them",
    )  # fmt: skip
    two_step: p.Flag = p.flag(
        False, title="Two-step procedure beside it", advanced=True,
        help="Boresight and lever arm by triangulation, then comparison with the navigation, "
        "into adjustment/report.json",
    )  # fmt: skip


class Adjust(Algorithm[AdjustParameters]):
    """Adjust poses, cameras, mount, clock and ground points in one step.

    Tie points, the navigation's joint covariance, control points and what is known of the camera
    are weighed against each other. Focal length, height above ground, angles and scale of the
    result are held against what was known before: a result that fails is not used, and the
    direct poses stay.
    """

    id, name, group = "adjust", "Adjust", "orient"
    needs, gives = ("photos", "poses", "ties"), ("adjusted",)
    in_run = True
    in_quick = False
    refines = True
    uses_settings = ("camera", "cameras", "mount", "gnss", "attitude", "ground", "control")

    def inputs(self, context: Context, parameters: AdjustParameters) -> Sequence[Path]:
        """Tie points, the trajectory's covariance, control, the DEM."""
        from processing_algorithms.orient.match import MATCHES, TIES

        project = context.require_project()
        settings = project.settings
        files = [settings.control.file, settings.control.marks, settings.ground.dem]
        found = [project.path(file) for file in files if file is not None]
        found += [project.adjustment / TIES, project.adjustment / MATCHES]
        found.append(project.navigation / "exposures.npz")
        return [path for path in found if path.exists()]

    def run(self, context: Context, parameters: AdjustParameters, feedback: Feedback) -> Result:
        """Adjust, judge, keep."""
        from georef_gis.errors import AdjustmentError
        from processing_algorithms.orient.adjusted_rows import forget, save
        from processing_algorithms.orient.control_input import project_control
        from processing_algorithms.site import load_site

        project = context.require_project()
        site = load_site(project, direct=True)
        if len(site.photos) < 2:
            forget(project)
            feedback.info("one photo alone: nothing to adjust")
            return Result(summary={"used": False})
        control = project_control(project, site, feedback)
        try:
            found = _adjusted(project, site, control, parameters, feedback)
        except AdjustmentError as error:
            forget(project)
            line = f"{error}; the direct result stays"
            feedback.warn(line)
            return Result(summary={"used": False, "doubts": [line]})
        answer, notes = found
        prepared, adjusted, checks = answer.prepared, answer.adjusted, answer.checks
        if answer.failed:
            forget(project)
            lines = [*notes, *(check.told() for check in answer.failed)]
            lines.append("the adjustment is not believed: the direct result stays")
            for line in lines:
                feedback.warn(line)
            return Result(summary={"used": False, "doubts": lines})
        beside = _two_step(project, prepared, adjusted) if parameters.two_step else None
        kept = save(context, site, prepared, adjusted, checks, notes, two_step=beside)
        for line in kept.doubts:
            feedback.warn(line)
        for line in kept.notes:
            feedback.info(line)
        return Result(outputs=kept.files, summary=kept.summary)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """One adjustment, how it was prepared, its checks."""

    prepared: Prepared
    adjusted: Adjusted
    checks: list[Check]

    @property
    def failed(self) -> list[Check]:
        return [check for check in self.checks if not check.passed]

    @property
    def told(self) -> list[str]:
        """What was decided on the way, and checks that passed with a remark."""
        return [*self.adjusted.notes, *(c.told() for c in self.checks if c.remark)]

    @property
    def focal_failed(self) -> Check | None:
        return next((c for c in self.failed if c.name.startswith("focal length")), None)


def _adjusted(
    project: Project,
    site: Site,
    control: ControlObservations | None,
    parameters: AdjustParameters,
    feedback: Feedback,
) -> tuple[_Found, list[str]]:
    """Adjustment and its checks, and notes; tried otherwise if the camera ran away.

    Raises
    ------
    AdjustmentError
        If there is nothing to adjust, or no solution.
    """

    def made(
        *, calibrate: bool, focal_share: float | None = None, wrong_headings: bool = False
    ) -> _Found:
        from processing_algorithms.orient.blocks import prepare

        prepared = prepare(
            project, site, calibrate=calibrate, control=control, focal_share=focal_share,
            wrong_headings=wrong_headings,
        )  # fmt: skip
        return _once(prepared, site, feedback)

    found = made(calibrate=parameters.calibrate)
    found, notes, once = _better_reading(made, found, parameters)
    notes += found.told
    if not parameters.calibrate or not found.failed:
        return found, notes
    off = found.focal_failed
    if off is not None:
        other = once(calibrate=True, focal_share=FOCAL_UNKNOWN)
        line = _told_of_focal(off, other)
        if not other.failed and _stated_focal_is_wrong(other, once):
            return other, [*notes, f"{line}: the photos are believed, beyond doubt"]
        notes.append(line)
    notes.append(f"with a free camera {found.failed[0].told()}: adjusted again, the camera held")
    held = once(calibrate=False)
    return held, list(dict.fromkeys([*notes, *held.told]))


def _once(prepared: Prepared, site: Site, feedback: Feedback) -> _Found:
    from georef_gis.errors import AdjustmentError
    from georef_gis.orient.adjustment.adjust import adjust
    from georef_gis.orient.adjustment.checks import plausibility
    from georef_gis.toolbox import check_cancelled

    def told(share: float, what: str) -> None:
        check_cancelled(feedback)
        feedback.progress(0.8 * share, what)

    block = prepared.block
    marked = block.control is not None and bool(block.control.used[block.control.point].any())
    if not block.ties.n_points and not marked:
        raise AdjustmentError("no photo shares a point with another")
    adjusted = adjust(block, prepared.first, cancelled=feedback.cancelled, progress=told)
    check_cancelled(feedback)
    checks = plausibility(adjusted, site.terrain)
    return _Found(prepared=prepared, adjusted=adjusted, checks=checks)


def _better_reading(
    made: Callable[..., _Found], found: _Found, parameters: AdjustParameters
) -> tuple[_Found, list[str], Callable[..., _Found]]:
    """Turned pixels, or wrong headings: which of the two agrees better, where matching found some.

    The places are the same; the principal point and the distortion lie the other way round.
    """
    from georef_gis.orient.adjustment.evidence import misfit

    named = [key for key, degrees in found.prepared.found_turned.items() if degrees]
    if not named:
        return found, [], made
    otherwise = partial(made, wrong_headings=True)
    other = otherwise(calibrate=parameters.calibrate)
    scatter = max(1.0, min(found.adjusted.sigma0, other.adjusted.sigma0))
    worse = misfit(found.adjusted, scatter=scatter) - misfit(other.adjusted, scatter=scatter)
    if worse <= BEYOND_DOUBT or len(other.failed) > len(found.failed):
        return found, [], made
    line = (
        f"{', '.join(named)}: not the pixels are turned but the headings in the tags are wrong: "
        "the lens fits better so"
    )
    return other, [line], otherwise


def _stated_focal_is_wrong(free: _Found, once: Callable[..., _Found]) -> bool:
    """Whether pixels and navigation contradict the stated focal length, all else being free.

    A wrong position also drags a free focal length away; with the focal length held, it is
    found wrong itself, and all the rest agrees.
    """
    from georef_gis.orient.adjustment.evidence import misfit

    held = once(calibrate=True, focal_share=0.0)
    scatter = max(1.0, free.adjusted.sigma0)
    worse = misfit(held.adjusted, scatter=scatter) - misfit(free.adjusted, scatter=scatter)
    return worse > BEYOND_DOUBT


def _told_of_focal(off: Check, free: _Found) -> str:
    camera = next(c for c in free.adjusted.cameras if off.name.endswith(c.id))
    return (
        f"project.toml, [camera] focal_px: {off.expected:.0f} px is what was stated or tagged, the "
        f"photos say {camera.fx:.0f} +- {camera.sigma_f:.0f} px; set it, or widen "
        "sigma_focal_percent"
    )


def _two_step(project: Project, prepared: Prepared, adjusted: Adjusted) -> dict[str, Any]:
    from processing_algorithms.orient.direct import project_mount
    from processing_algorithms.orient.two_step_beside import two_step_beside

    return two_step_beside(prepared, adjusted, project_mount(project))
