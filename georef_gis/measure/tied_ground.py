"""How a ground made of adjusted points errs with the photos that it was made from.

Its height at a place is that of the points about it, and each of them was intersected from the
photos that see it: to first order the surface errs as a point there would that all of these photos
show, many pixels having averaged the clicks away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.scene import Scene
from georef_gis.model.intersection_rays import PARALLEL, Bools
from georef_gis.model.photo_stack import Ints
from georef_gis.model.tin import TinTerrain

# photos of a place that count, those first which show it nearest to their middle
_MOST_VIEWS = 12
# pairs of a place and a photo that are looked at together
_MOST_PAIRS = 400_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TiedHeights:
    """Errors of the ground's height at n places by those of the photos.

    Parameters
    ----------
    tied : shape (n,)
        Whether two photos or more from different sides tell the height.
    place, photo : shape (m,)
        Pairs of a place that is tied and a photo.
    by_pose, by_camera : shapes (m, 6), (m, 11)
        Derivatives of the height by the pose's error and by the sensor's, "true minus stated".
    """

    tied: Bools
    place: Ints
    photo: Ints
    by_pose: Array
    by_camera: Array


def tied_heights(scene: Scene, p_enu: Array, normal: Array) -> TiedHeights:
    """How heights of the ground err with the photos.

    Parameters
    ----------
    p_enu : shape (n, 3), m
        On the ground.
    normal : shape (n, 3)
        Of the ground, scaled to up = 1.
    """
    place, photo = _views_of(scene, p_enu)
    views = scene.photos.views(photo, p_enu[place])
    J = views.by_point
    total = np.zeros((len(p_enu), 3, 3))
    np.add.at(total, place, np.swapaxes(J, 1, 2) @ J)
    values = np.linalg.eigvalsh(total)
    # along the rays nothing is told unless they come from different sides
    tied = values[:, 0] > PARALLEL * np.maximum(values[:, 2], 1e-300)
    kept = tied[place]
    place, photo, J = place[kept], photo[kept], J[kept]
    gain = np.linalg.inv(total[place]) @ np.swapaxes(J, 1, 2)
    # the place follows the stated poses: it errs the other way
    along = -np.einsum("mi,mij->mj", normal[place], gain)
    by_sensor = scene.errors.by_sensor(photo, views.by_camera[kept])
    return TiedHeights(
        tied=tied,
        place=place,
        photo=photo,
        by_pose=np.einsum("mj,mjk->mk", along, views.by_pose[kept]),
        by_camera=np.einsum("mj,mjk->mk", along, by_sensor),
    )


def tied_parts(scene: Scene, tied: TiedHeights, by_height: Array) -> list[tuple[Ints, Ints, Array]]:
    """How places hang on the photos through the ground's height, as `shared_rows` takes it.

    Parameters
    ----------
    by_height : shape (n, 3), m/m
        Derivatives of the places by the height of the ground.
    """
    up = by_height[tied.place][:, :, None]
    columns = scene.errors.camera_columns(tied.photo)
    return [
        (tied.place, 6 * tied.photo, up * tied.by_pose[:, None]),
        (tied.place, columns, up * tied.by_camera[:, None]),
    ]


def untied_variance(scene: Scene, tied: TiedHeights) -> Array:
    """Variance of heights by the surface's shared sigma where no two photos tell them; (n,) m^2."""
    shared = scene.terrain.sigma_shared if isinstance(scene.terrain, TinTerrain) else 0.0
    return np.where(tied.tied, 0.0, shared**2)


def _views_of(scene: Scene, p_enu: Array) -> tuple[Ints, Ints]:
    """Pairs of places and of photos of the ground that show them, at most so many for each."""
    stack, made = scene.photos, scene.ground_photos
    size = np.array([[c.width, c.height] for c in stack.cameras])[stack.camera_of]
    places, photos = [], []
    step = max(_MOST_PAIRS // len(made), 1)
    for first in range(0, len(p_enu), step):
        part = np.arange(first, min(first + step, len(p_enu)))
        i, k = (x.ravel() for x in np.meshgrid(part, made, indexing="ij"))
        uv = stack.project(k, p_enu[i])
        seen = np.flatnonzero(stack.contains(k, uv))
        i, k, uv = i[seen], k[seen], uv[seen]
        away = np.linalg.norm((uv - (size[k] - 1) / 2) / size[k], axis=1)
        order = np.lexsort((away, i))
        rank = np.arange(len(i)) - np.searchsorted(i[order], i[order])
        best = order[rank < _MOST_VIEWS]
        places.append(i[best])
        photos.append(k[best])
    none = np.zeros(0, dtype=np.int64)
    return np.concatenate([none, *places]), np.concatenate([none, *photos])
