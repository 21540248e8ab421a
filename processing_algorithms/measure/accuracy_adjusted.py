"""What the accuracy statement takes from an adjustment: joint covariance, sigmas of distances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.model.intersection import JointCovariance
    from georef_gis.project import Project
    from processing_algorithms.site import Site

# what an adjustment says of itself, in the project's folder `adjustment`
REPORT = "report.json"


def joint_covariance(project: Project, site: Site) -> JointCovariance | None:
    """Joint covariance of the adjusted poses, where all are and the adjustment kept it."""
    from georef_gis.project.joint_covariance import load_pose_covariance

    if any(kind != "adjusted" for kind in site.pose_kinds.values()):
        return None
    kept = load_pose_covariance(project.adjustment / "covariance.npz")
    if kept is None or kept.of(list(site.photos)) is None:
        return None

    def joint(photo_ids: Sequence[str]) -> Array:
        found = kept.of(photo_ids)
        if found is None:
            raise KeyError(f"no joint covariance of {photo_ids}")
        return found

    return joint


def distances(project: Project, site: Site) -> tuple[tuple[float, float], ...]:
    """Lengths and one sigma of distances, m, where the products rest on an adjustment that tells.

    Raises
    ------
    InputError
        If what the adjustment left is broken.
    """
    import json

    from georef_gis.errors import InputError
    from processing_algorithms.site import mostly_adjusted

    path = project.adjustment / REPORT
    if not mostly_adjusted(site.pose_kinds.values()) or not path.is_file():
        return ()
    try:
        told = json.loads(path.read_text(encoding="utf-8")).get("distances") or ()
        return tuple((float(one["length_m"]), float(one["sigma_m"])) for one in told)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"cannot be read ({error}); run `georef adjust --force`", source=str(path)
        ) from error
