"""Place of matched clicks: what the user meant is unsure once, however many photos show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.intersecting import intersect_points
from georef_gis.measure.measured import MeasuredPoints
from georef_gis.measure.scene import Scene
from georef_gis.model.control import Mark
from georef_gis.model.ground_point import ground_normal, ground_sensitivities


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedClick:
    """The click that matched marks were made from: `mark`; one sigma of it, px, that they share."""

    mark: Mark
    sigma_px: float


def intersect_matched(scene: Scene, marks: Sequence[Mark], click: SharedClick) -> MeasuredPoints:
    """Place of one object by marks that were matched from one click.

    Parameters
    ----------
    marks
        `sigma_px` is that of the match alone; the click's own mark is among them.

    Raises
    ------
    GeometryError
        As in `intersect_points`.

    Notes
    -----
    A click beside what it means makes all matches show the same wrong spot. So their rays meet as
    well as the matches are good, at a place that is off by the click's error, moved along the
    ground: its covariance is added once and does not fall with the number of photos.
    """
    points = intersect_points(scene, marks)
    by_click = meant(points, click)
    return replace(points, own=points.own + by_click, each=points.each + by_click)


def meant(points: MeasuredPoints, click: SharedClick) -> Array:
    """Covariance of a place by what a click may have missed its object; (1, 3, 3) m^2."""
    scene, p = points.scene, points.p_enu
    mark = click.mark
    k = np.array([scene.number(mark.photo)])
    uv = np.array([[mark.u, mark.v]])
    normal = ground_normal(scene.terrain, p)
    J = ground_sensitivities(scene.photos, k, uv, p, normal).by_uv * click.sigma_px
    return np.asarray(J @ np.swapaxes(J, 1, 2))


def kept_sigma(sigma_match: float, shared: float, rays: int) -> float:
    """One sigma, px, of a matched mark that is to be kept as if it were a click of its own.

    Marks of `rays` photos then give the plan as unsure as it is, and the height less sure than it
    is: what is taken as independent falls with the root of their number.

    Parameters
    ----------
    sigma_match, shared : px
        Of the match; and of the click that all share, in the mark's own photo.
    """
    return float(np.hypot(sigma_match, shared * np.sqrt(rays)))
