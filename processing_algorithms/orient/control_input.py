"""Control points of a project as an adjustment takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.model.control import ControlObservations
    from georef_gis.project import Project
    from georef_gis.toolbox import Feedback
    from processing_algorithms.site import Site


def project_control(project: Project, site: Site, feedback: Feedback) -> ControlObservations | None:
    """Control with the marks that its checks leave; None where the project names none.

    What is wrong with it was told by the tool `control`; a file that cannot be read is told here
    and stops nothing, for photos can be adjusted without.
    """
    from georef_gis.errors import InputError

    if project.settings.control.file is None:
        return None
    from processing_algorithms.measure.control import load_control

    try:
        return load_control(project, site)
    except InputError as error:
        feedback.warn(f"{error}; adjusted without control")
        return None
