"""Control points of a project as an adjustment takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.model.control import ControlObservations
    from georef_gis.project import Project
    from georef_gis.toolbox import Feedback
    from processing_algorithms.measure.control import LoadedControl
    from processing_algorithms.site import Site


def project_control(project: Project, site: Site, feedback: Feedback) -> ControlObservations | None:
    """Control with the marks that its checks leave; None where nothing of it can be used.

    Photos can be adjusted without control, so a file that is left out as a whole stops nothing: it
    is told here, in one line with the reason. What is wrong with single points and marks is told by
    the tool `control`.
    """
    from processing_algorithms.measure.control import examine_control

    loaded = examine_control(project, site)
    if loaded is None:
        return None
    found = loaded.usable
    if found is None or not len(found.photo_ids):
        feedback.warn(_left_out(project, loaded))
        return None
    return found


def _left_out(project: Project, loaded: LoadedControl) -> str:
    """Why nothing of the control can be used, one line."""
    if loaded.control is None:
        # the very words of the tool `control`: a run tells them once
        return loaded.doubts[0]
    file = project.settings.control.file
    if not loaded.control.marks:
        why = "no point has a mark in a photo; name the file of marks ([control] marks)"
    elif loaded.doubts:
        more = len(loaded.doubts) - 1
        why = loaded.doubts[0] + (f" (and {more} more: see `georef control`)" if more else "")
    else:
        why = "every point with a mark is off ([control] off)"
    return f"{file}: adjusted without control: {why}"
