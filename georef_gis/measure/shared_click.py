"""Marks that were matched from one click: what it missed of its object is unsure once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.scene import Scene
from georef_gis.model.ground_point import ground_normal, ground_sensitivities
from georef_gis.model.intersection_rays import Marks
from georef_gis.model.intersections import intersect_many
from georef_gis.model.photo_stack import Ints


def with_common(scene: Scene, marks: Marks, shared: Array) -> Marks:
    """Marks that know what error those of one point have in common.

    Parameters
    ----------
    shared : shape (m,), px
        One sigma of it in the mark's own photo; 0 where a mark was not matched. It is taken as it
        is in the photo of the first mark of a point that has one: there is the click.

    Notes
    -----
    A click beside what it means makes all matches show the same wrong spot. So their rays meet as
    well as the matches are good, at a place that is off by the click's error, moved along the
    ground: that does not fall with the number of photos.
    """
    at = np.flatnonzero(shared > 0.0)
    if not len(at):
        return marks
    points, first = np.unique(marks.point[at], return_index=True)
    rows = np.flatnonzero(np.isin(marks.point, points))
    number = np.searchsorted(points, marks.point)
    some = Marks(
        photo=marks.photo[rows], point=number[rows], uv=marks.uv[rows], sigma=marks.sigma[rows]
    )
    p = intersect_many(scene.errors, some).p_enu
    # without a place there is nothing to share it at
    at = at[np.isfinite(p[number[at], 0])]
    clicked = np.flatnonzero(shared > 0.0)[first]
    p = np.where(np.isfinite(p), p, 0.0)
    moved = _along_ground(scene, marks, clicked, p) * shared[clicked, None, None]
    common = np.zeros((len(marks.photo), 2, 2))
    views = scene.photos.views(marks.photo[at], p[number[at]])
    common[at] = views.by_point @ moved[number[at]]
    return replace(marks, common=common)


def _along_ground(scene: Scene, marks: Marks, rows: Ints, p_enu: Array) -> Array:
    """By how much places move along the ground when their clicks do; (n, 3, 2) m/px."""
    normal = ground_normal(scene.terrain, p_enu)
    return ground_sensitivities(
        scene.photos, marks.photo[rows], marks.uv[rows], p_enu, normal
    ).by_uv
