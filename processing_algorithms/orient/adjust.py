"""Tool `adjust`: poses, cameras, mount, clock and ground from tie points, navigation, control."""

from __future__ import annotations

from collections.abc import Sequence
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

REPORT = "report.json"


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
        prepared, adjusted, checks, notes = found
        failed = [check for check in checks if not check.passed]
        if failed:
            forget(project)
            lines = [*notes, *(check.told() for check in failed)]
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


def _adjusted(
    project: Project,
    site: Site,
    control: ControlObservations | None,
    parameters: AdjustParameters,
    feedback: Feedback,
) -> tuple[Prepared, Adjusted, list[Check], list[str]]:
    """Adjustment and its checks; once more with the camera held if it ran away.

    Raises
    ------
    AdjustmentError
        If there is nothing to adjust, or no solution.
    """
    from georef_gis.errors import AdjustmentError
    from georef_gis.orient.adjustment.adjust import adjust
    from georef_gis.orient.adjustment.checks import plausibility
    from georef_gis.toolbox import check_cancelled
    from processing_algorithms.orient.blocks import prepare

    def told(share: float, what: str) -> None:
        check_cancelled(feedback)
        feedback.progress(0.8 * share, what)

    notes: list[str] = []
    for calibrate in (True, False) if parameters.calibrate else (False,):
        prepared = prepare(project, site, calibrate=calibrate, control=control)
        block = prepared.block
        marked = block.control is not None and bool(block.control.used[block.control.point].any())
        if not block.ties.n_points and not marked:
            raise AdjustmentError("no photo shares a point with another")
        adjusted = adjust(block, prepared.first, cancelled=feedback.cancelled, progress=told)
        check_cancelled(feedback)
        checks = plausibility(adjusted, site.terrain)
        if all(check.passed for check in checks) or not calibrate:
            break
        failed = next(check for check in checks if not check.passed)
        if failed.name.startswith("focal length"):
            notes.append(
                f"project.toml, [camera] focal_px: {failed.expected:.0f} px is what was stated or "
                f"tagged, the photos say about {failed.value:.0f} px; set it, or widen "
                "sigma_focal_percent"
            )
        notes.append(f"with a free camera {failed.told()}: adjusted again with the camera held")
    return prepared, adjusted, checks, notes


def _two_step(project: Project, prepared: Prepared, adjusted: Adjusted) -> dict[str, Any]:
    from processing_algorithms.orient.direct import project_mount
    from processing_algorithms.orient.two_step_beside import two_step_beside

    return two_step_beside(prepared, adjusted, project_mount(project))
